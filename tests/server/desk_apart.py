"""A desk in a process of its own, which a test commands by lines; see `test_managers_apart`."""

# ruff: noqa: T201 - it is read by its lines
from __future__ import annotations

import asyncio
import sys
import threading
from contextlib import suppress
from pathlib import Path

from uoarm import RobotManager
from uoarm.client import connect
from uoarm.config import loads

DESK = """
version: 1
bridges:
  far: {{plugin: remote, options: {{url: "{url}", token_file: "{token}", silence: 1, grace: 3600}}}}
functions:
  drive: {{components: [{{name: far_base, bridge: far, input: {{endpoint: [drive]}}}}]}}
  counter: {{components: [{{name: far_counter, bridge: far, output: {{endpoint: [counter]}}}}]}}
"""


def import_functions(url: str, token: str) -> None:
    """Renew a command and count what comes until a line is read; then say what was lost."""
    with (
        RobotManager(loads(DESK.format(url=url, token=token))) as robot,
        robot.request("drive") as drive,
        robot.request("counter") as counter,
    ):
        over = threading.Event()

        def wait_for_line() -> None:
            sys.stdin.readline()
            over.set()

        threading.Thread(target=wait_for_line, daemon=True).start()
        numbers: list[int] = []
        while not over.wait(0.05):
            drive.send({"speed": 0.5})
            print("breaks", dict(robot.status().bridges[0].facts)["breaks"], flush=True)
            with suppress(TimeoutError):
                while True:
                    numbers.append(counter.get(0)["value"])
        components = {item.name: item for item in robot.status().components}
        facts = dict(components["far_counter"].channels[0].facts)
        missing = numbers[-1] - numbers[0] + 1 - len(numbers)
        print("lost", missing, facts["lost_on_link"], facts["gaps"], flush=True)


async def send_lines(url: str, token: str) -> None:
    """Send a command at each line, without waiting for the answer."""
    async with connect(url, token=token, resume=False, reconnect=0.0) as robot:
        drive = await robot.request("drive", receive=False)
        print("open", flush=True)
        sending = []
        while line := await asyncio.to_thread(sys.stdin.readline):
            sending.append(asyncio.ensure_future(drive.send({"speed": float(line)})))
            await asyncio.sleep(0.01)  # turns in which it is written to the socket
            print("sent", flush=True)


if __name__ == "__main__":
    kind, url, token = sys.argv[1:]
    if kind == "import":
        import_functions(url, token)
    else:
        asyncio.run(send_lines(url, Path(token).read_text(encoding="ascii")))
