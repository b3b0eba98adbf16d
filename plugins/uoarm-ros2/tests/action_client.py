"""An ordinary roslibpy program that sends goals to a ROS 2 action behind `uoarm serve`."""

from __future__ import annotations

import sys
from queue import SimpleQueue
from typing import Any

import roslibpy

from uoarm.testing import patience

SECONDS = patience()
ENDS = {"succeeded": 4, "canceled": 5, "aborted": 6}


def main(url: str) -> None:
    ros = roslibpy.Ros(url)
    ros.run(timeout=SECONDS)
    action = roslibpy.ActionClient(ros, "/uoarm/fibonacci", "test_msgs/Fibonacci")
    reports: SimpleQueue[tuple[str, Any]] = SimpleQueue()

    def send(order: int) -> str:
        identity: str = action.send_goal(
            roslibpy.Goal({"order": order}),
            lambda result: reports.put(("result", result)),
            lambda feedback: reports.put(("feedback", list(feedback["sequence"]))),
            lambda error: reports.put(("error", error)),
        )
        return identity

    def end() -> tuple[list[Any], str, Any]:
        steps = []
        while (one := reports.get(timeout=SECONDS))[0] == "feedback":
            steps.append(one[1])
        return steps, *one

    send(6)
    steps, kind, result = end()
    assert kind == "result", result
    assert steps[-1] == [0, 1, 1, 2, 3, 5, 8], steps
    assert result["status"].value == ENDS["succeeded"], result
    assert result["values"] == {"sequence": [0, 1, 1, 2, 3, 5, 8]}, result

    identity = send(1000)
    assert reports.get(timeout=SECONDS)[0] == "feedback"
    action.cancel_goal(identity)
    _, kind, result = end()
    assert (kind, result["status"].value) == ("result", ENDS["canceled"]), result

    send(13)
    _, kind, result = end()
    assert (kind, result["status"].value) == ("result", ENDS["aborted"]), result

    send(-1)
    _, kind, error = end()
    assert kind == "error", error
    assert "rejected" in error["values"], error
    ros.close()
    print("done")  # noqa: T201 - the test waits for it


if __name__ == "__main__":
    main(sys.argv[1])
