"""An ordinary roslibpy program, run against the server: each step fails loudly or passes."""

from __future__ import annotations

import base64
import sys
import threading
from queue import SimpleQueue
from typing import Any

import roslibpy

from uoarm.testing import patience

SECONDS = patience()


def main(url: str) -> None:
    roslibpy.set_rosapi_timeout(SECONDS)  # its own limit is three seconds
    ros = roslibpy.Ros(url)
    ros.run(timeout=SECONDS)
    look_around(ros)
    receive(ros)
    publish(ros)
    call(ros)
    provide(ros)
    fail(ros)
    send_goals(ros)
    ros.close(timeout=SECONDS)
    print("done")  # noqa: T201 - the test waits for it


def look_around(ros: Any) -> None:
    topics = ros.get_topics()
    assert "/uoarm/numbers" in topics, topics
    assert ros.get_topic_type("/uoarm/numbers") == "Number"
    assert "/uoarm/numbers" in ros.get_topics_for_type("Number")
    assert "/uoarm/add" in ros.get_services()
    assert ros.get_service_type("/uoarm/add") == "Pair"
    assert "/uoarm/add" in ros.get_services_for_type("Pair")
    assert "/adder" in ros.get_nodes()
    assert ros.get_node_details("/adder")["services"] == ["/uoarm/add"]
    assert ros.get_message_details("Picture")["typedefs"][0]["fieldnames"] == ["width", "data"]
    assert ros.get_service_request_details("Pair")["typedefs"]
    assert ros.get_service_response_details("Pair")["typedefs"]
    assert ros.get_time()["secs"] > 1_600_000_000
    assert ros.get_params() == []
    replies: SimpleQueue[Any] = SimpleQueue()
    ros.get_action_servers(replies.put)
    assert "/uoarm/navigate" in replies.get(timeout=SECONDS)["action_servers"]


def receive(ros: Any) -> None:
    """Subscribe; the test plays numbers as soon as the topic is open."""
    numbers: list[int] = []
    enough = threading.Event()

    def take(message: Any) -> None:
        numbers.append(message["value"])
        if len(numbers) == 3:
            enough.set()

    topic = roslibpy.Topic(ros, "/uoarm/doubled", "any/Type", queue_length=10)
    topic.subscribe(take)
    assert enough.wait(SECONDS), numbers
    assert numbers == [2, 4, 6], numbers
    topic.unsubscribe()
    picture = roslibpy.Topic(ros, "/uoarm/picture", "any/Type")
    seen: SimpleQueue[Any] = SimpleQueue()
    picture.subscribe(seen.put)
    assert base64.b64decode(seen.get(timeout=SECONDS)["data"]) == bytes(range(256))
    picture.unsubscribe()


def publish(ros: Any) -> None:
    received: list[int] = []
    all_received = threading.Event()

    def take(message: Any) -> None:
        received.append(message["value"])
        if message["value"] == 20:
            all_received.set()

    listener = roslibpy.Topic(ros, "/uoarm/echo", "any/Type")
    listener.subscribe(take)
    ros.get_time()
    talker = roslibpy.Topic(ros, "/uoarm/echo", "any/Type")
    for value in range(21):
        talker.publish(roslibpy.Message({"value": value}))
    assert all_received.wait(SECONDS), received
    talker.unadvertise()
    listener.unsubscribe()


def call(ros: Any) -> None:
    service = roslibpy.Service(ros, "/uoarm/add", "any/Type")
    reply = service.call(roslibpy.ServiceRequest({"a": 2, "b": 3}), timeout=SECONDS)
    assert reply["value"] == 5, reply


def provide(ros: Any) -> None:
    """Provide a service to oneself, through the server."""

    def half(request: Any, response: Any) -> bool:
        response["x"] = request["x"] / 2
        return True

    service = roslibpy.Service(ros, "/half", "any/Half")
    service.advertise(half)
    client = roslibpy.Service(ros, "/half", "any/Half")
    answers: SimpleQueue[Any] = SimpleQueue()
    client.call(roslibpy.ServiceRequest({"x": 8}), callback=answers.put, errback=answers.put)
    assert answers.get(timeout=SECONDS)["x"] == 4
    service.unadvertise()


def fail(ros: Any) -> None:
    service = roslibpy.Service(ros, "/uoarm/broken", "any/Type")
    try:
        service.call(roslibpy.ServiceRequest({"value": 6}), timeout=SECONDS)
    except roslibpy.core.ServiceException as error:
        assert "cannot do 6" in str(error), error
    else:
        raise AssertionError("a broken service answered")


def send_goals(ros: Any) -> None:
    reports: SimpleQueue[tuple[str, Any]] = SimpleQueue()

    def send(value: int) -> Any:
        return client.send_goal(
            roslibpy.Goal({"value": value}),
            lambda result: reports.put(("result", result)),
            lambda feedback: reports.put(("feedback", feedback)),
            lambda error: reports.put(("error", error)),
        )

    client = roslibpy.ActionClient(ros, "/uoarm/navigate", "any/Walk")
    client.wait_goal(send(2), timeout=SECONDS)
    came = [reports.get(timeout=SECONDS) for _ in range(3)]
    assert [kind for kind, _ in came] == ["feedback", "feedback", "result"], came
    assert came[1][1]["step"] == 1, came
    assert came[2][1] == {"status": roslibpy.GoalStatus.SUCCEEDED, "values": {"walked": 2}}, came
    client.cancel_goal(send(0))
    kind, result = reports.get(timeout=SECONDS)
    assert (kind, result["status"]) == ("result", roslibpy.GoalStatus.CANCELED), result
    send(-1)
    kind, error = reports.get(timeout=SECONDS)
    assert kind == "error", error
    assert "rejected" in error["values"], error


if __name__ == "__main__":
    main(sys.argv[1])
