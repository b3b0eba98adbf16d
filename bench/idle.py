"""What a manager costs while little happens: processor time and wake-ups of its threads.

    python -m bench.idle            each plugin with an open connection
    python -m bench.idle ros2 mqtt  some of it

First nothing happens, then ten times a second a message of some 100 octets comes, or a call of as
much goes. A loop that turned for nothing would show in one of both. Each manager runs in a process
of its own; what it is connected to is another one and not counted. A wake-up is a thread that
waited and was given a processor again.
"""

from __future__ import annotations

import os
import re
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from attrs import frozen

from bench.tables import print_table
from bench.turns import Child, module, running, wait_for_port
from uoarm.testing import free_port

SECONDS = 20.0
SETTLE_SECONDS = 5.0
_END_SECONDS = 20.0
PERIOD_SECONDS = 0.1
TEXT = "x" * 100
_VEHICLE = """
import signal, sys, time
from uoarm_vda5050.vehicle import Vehicle
moving = []
signal.signal(signal.SIGUSR1, lambda *_: moving.append(1))
with Vehicle(sys.argv[1], "uoa", "agv1") as vehicle:
    vehicle.set(position=(0.0, 0.0, 0.0, "floor"))
    print("ready", flush=True)
    while True:
        time.sleep(0.1)
        if moving:
            vehicle.set(battery=time.monotonic() % 100)
"""
_CLIENT = """
import json, sys
from websockets.sync.client import connect
names = ["foxglove.sdk.v1"] if "foxglove" in sys.argv[1] else None
with connect(sys.argv[1], subprotocols=names) as client:
    for ask in sys.argv[2:]:
        client.send(ask)
    for frame in client:
        if isinstance(frame, str) and (channels := json.loads(frame).get("channels")):
            asks = [{"id": channel["id"], "channelId": channel["id"]} for channel in channels]
            client.send(json.dumps({"op": "subscribe", "subscriptions": asks}))
"""
_ASKS = {
    "/": ['{"op": "Request", "type": "idle", "id": "1", "jsonMessage": {}}'],
    "/rosbridge": ['{"op": "subscribe", "topic": "/uoarm/idle"}'],
}
_ECHO = 'service: {endpoint: ["bench._components:text"]}'
_EMITS = "output: {endpoint: [idle]}"


class Peers(ExitStack):
    """What a manager is connected to.

    Attributes:
        latest: the program that was started last.
    """

    latest: Child

    def run(self, *words: str) -> Child:
        """Run a program until the end."""
        self.latest = self.enter_context(running(words, signal.SIGTERM))
        return self.latest

    def listening(self, port: int, *words: str) -> str:
        """Run a program until the end; return its address once it listens."""
        self.run(*words)
        wait_for_port(port)
        return f"127.0.0.1:{port}"


@frozen
class Case:
    """A manager that is idle.

    Attributes:
        bridge: its line in the configuration; `{}` is the place of the peer.
        endpoint: of its function.
        peer: starts what it is connected to, and returns where that is.
        serves: front ends of the server before it, the first of which a client is connected to.
        records: whether the function is recorded.
        sends: the input, as `endpoint`, to which another process sends what comes; empty: it is
            made, or called, in the manager's.
        message: what comes; services are called with a `Text`.
    """

    bridge: str
    endpoint: str
    peer: Callable[[Peers], str] | None = None
    serves: tuple[str, ...] = ()
    records: bool = False
    sends: str = ""
    message: Any = TEXT


def _mosquitto(stack: Peers) -> str:
    port = free_port()
    program = shutil.which("mosquitto") or "/usr/sbin/mosquitto"
    return "mqtt://" + stack.listening(port, program, "-p", str(port))


def _vehicle(stack: Peers) -> str:
    url = _mosquitto(stack)
    stack.run(sys.executable, "-c", _VEHICLE, url).said("(ready)")
    return url


def _master(stack: Peers) -> str:
    port = free_port()
    return "http://" + stack.listening(port, "rosmaster", "--core", "-p", str(port))


def _component(stack: Peers) -> str:
    from uoarm_rtm.nameserver import NameServer  # noqa: PLC0415

    address: str = stack.enter_context(NameServer()).address
    stack.run(*module("bench.rtm_ports", "serve", address)).said("(ready)")
    return address


def _device(stack: Peers) -> str:
    from bench.rocos_line import SIMULATED  # noqa: PLC0415 - with its plugin only

    return stack.run(*SIMULATED, "--tcp", "0").said(r"(tcp://\S+)")


def _manager(stack: Peers) -> str:
    file = Path(stack.enter_context(tempfile.TemporaryDirectory())) / "robot.yaml"
    text = _robot("idle_bridge: {plugin: python}", _ECHO) + "export: {local: [idle]}\n"
    file.write_text(text, encoding="utf-8")
    words = module("uoarm", "serve", str(file), "--port", "0")
    return stack.run(*words).said(r"(ws://\S+?)/? ")


CASES = {
    "memory": Case("{plugin: memory}", _EMITS),
    "host": Case("{plugin: python, host: true}", _ECHO),
    "server": Case("{plugin: memory}", _EMITS, serves=("/",)),
    "rosbridge server": Case("{plugin: memory}", _EMITS, serves=("/rosbridge",)),
    "foxglove": Case("{plugin: memory}", _EMITS, serves=("/foxglove",)),
    "mcp": Case("{plugin: python}", _ECHO, serves=("", "mcp")),
    "recorder": Case("{plugin: memory}", _EMITS, records=True),
    "ros2": Case(
        "{plugin: ros2}",
        "output: {endpoint: [/idle, std_msgs/msg/String], options: {peer: optional}}",
        sends="input: {endpoint: [/idle, std_msgs/msg/String], options: {peer: optional}}",
        message={"data": TEXT},
    ),
    "ros1": Case(
        "{{plugin: ros1, options: {{master: '{}'}}}}",
        "output: {endpoint: [/idle, std_msgs/String], options: {peer: optional}}",
        _master,
        sends="input: {endpoint: [/idle, std_msgs/String], options: {peer: optional}}",
        message={"data": TEXT},
    ),
    "mqtt": Case(
        "{{plugin: mqtt, options: {{url: '{}'}}}}",
        "output: {endpoint: [idle], structure: {type: string}}",
        _mosquitto,
        sends="input: {endpoint: [idle], structure: {type: string}}",
    ),
    "vda5050": Case(
        "{{plugin: vda5050, options: {{url: '{}', release: '2.1'}}}}",
        "output: {endpoint: [uoa, agv1, state]}",
        _vehicle,
    ),
    "rtm": Case(
        "{{plugin: rtm, options: {{nameserver: '{}'}}}}",
        "output: {endpoint: [Echo0.rtc, small_out]}",
        _component,
        sends="input: {endpoint: [Echo0.rtc, small_in]}",
        message={"tm": {"sec": 1, "nsec": 2}, "data": 7},
    ),
    "rocos": Case(
        "{{plugin: rocos, options: {{devices: {{robot: {{url: '{}'}}}}}}}}",
        "service: {endpoint: [robot, echo]}",
        _device,
    ),
    "rosbridge client": Case(
        "{{plugin: rosbridge, options: {{url: '{}/rosbridge'}}}}",
        "service: {endpoint: [/uoarm/idle]}",
        _manager,
    ),
    "remote": Case(
        "{{plugin: remote, options: {{url: '{}/'}}}}", "service: {endpoint: [idle]}", _manager
    ),
}


def _robot(bridge_line: str, endpoint: str) -> str:
    name = bridge_line.partition(":")[0]
    return (
        f"version: 1\nbridges:\n  {bridge_line}\nfunctions:\n"
        f"  idle: {{components: [{{name: idle, bridge: {name}, {endpoint}}}]}}\n"
    )


def main() -> int:
    """Print the table."""
    if sys.argv[1:2] in (["--run"], ["--send"]):
        (_run if sys.argv[1] == "--run" else _send)(*sys.argv[2:])
        return 0
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_DOMAIN_ID", str(20 + os.getpid() % 80))
    rows = []
    for name in sys.argv[1:] or CASES:
        try:
            rows.append((name, *_measured(name)))
        except (OSError, RuntimeError, ImportError, ValueError) as error:
            print(f"no row for {name}: {error}", file=sys.stderr)
    columns = (
        "manager with", "CPU % of a core", "wake-ups a second",
        "with 10 messages a second: CPU %", "wake-ups", "load",
    )  # fmt: skip
    print_table("idle managers", columns, rows)
    return 0


def _measured(name: str) -> tuple[str, ...]:
    case = CASES[name]
    with Peers() as stack:
        place = case.peer(stack) if case.peer is not None else ""
        with running(module("bench.idle", "--run", name, place)) as manager:
            manager.said("(ready)")
            idle = _cost(manager.process.pid)
            print("go", file=manager.process.stdin, flush=True)
            if case.peer is _vehicle:
                stack.latest.process.send_signal(signal.SIGUSR1)
            if case.sends:
                stack.run(*module("bench.idle", "--send", name, place)).said("(ready)")
            manager.said("(came)")
            return (*idle, *_cost(manager.process.pid), f"{os.getloadavg()[0]:.1f}")


def _cost(process: int) -> tuple[str, str]:
    """Return what a manager takes for a while."""
    time.sleep(SETTLE_SECONDS)
    before, began = _threads(_family(process)), time.monotonic()
    time.sleep(SECONDS)
    after, seconds = _threads(_family(process)), time.monotonic() - began
    computed, woken = (
        sum(found[kind] - before.get(thread, (0, 0))[kind] for thread, found in after.items())
        for kind in (0, 1)
    )
    return f"{computed / seconds / 1e7:.2f}", f"{woken / seconds:.1f}"


def _family(process: int) -> list[int]:
    """Return a process and those that it started, hosts among them."""
    found = [process]
    for parent in found:
        for task in Path(f"/proc/{parent}/task").iterdir():
            found += map(int, (task / "children").read_text().split())
    return found


def _threads(processes: Iterable[int]) -> dict[int, tuple[int, int]]:
    """Return nanoseconds computed, and waits that ended, of each thread."""
    found = {}
    for process in processes:
        for task in Path(f"/proc/{process}/task").iterdir():
            with suppress(OSError):
                computed = int((task / "schedstat").read_text().split()[0])
                waits = re.search(
                    r"^voluntary_ctxt_switches:\s+(\d+)",
                    (task / "status").read_text(),
                    re.MULTILINE,
                )
                assert waits is not None, "Linux says it"
                found[int(task.name)] = (computed, int(waits[1]))
    return found


def _run(name: str, place: str) -> None:
    """Be the manager until standard input ends; a line there has messages come."""
    from uoarm import RobotManager  # noqa: PLC0415
    from uoarm.config import loads  # noqa: PLC0415
    from uoarm.testing import MemoryBridge  # noqa: PLC0415

    case = CASES[name]
    memory = MemoryBridge("idle_bridge")
    emitter = memory.emitter("idle", {"type": "string"})
    given = {"idle_bridge": memory} if "memory" in case.bridge else {}
    came, over = threading.Event(), threading.Event()
    with Peers() as stack:
        file = loads(_robot(_bridge_line(case, place), case.endpoint))
        robot = stack.enter_context(RobotManager(file, bridges=given))
        is_service = case.endpoint.startswith("service")
        take = None if is_service else lambda _: came.set()
        stack.enter_context(robot.request("idle", on_message=take))
        if case.records:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            stack.enter_context(robot.record("idle", path=folder / "idle.mcap"))
        if case.serves:
            from uoarm.server import ServerOptions, serve_in_thread  # noqa: PLC0415

            ports = dict.fromkeys(case.serves[1:], 0)
            options = ServerOptions(port=0, front_end_ports=ports)
            server = stack.enter_context(serve_in_thread(robot, options))
            if path := case.serves[0]:
                url = f"ws://127.0.0.1:{server.ports[0]}{path}"
                stack.run(sys.executable, "-c", _CLIENT, url, *_ASKS.get(path, ()))
        print("ready", flush=True)
        sys.stdin.readline()

        def act() -> None:
            if is_service:
                robot.call("idle", {"text": TEXT})
                came.set()
            else:
                emitter.emit(case.message)

        if is_service or given:
            acting = threading.Thread(target=_again_and_again, args=(act, over), name="bench")
            acting.start()
            stack.callback(acting.join)
            stack.callback(over.set)
        if not came.wait(_END_SECONDS):
            return
        print("came", flush=True)
        sys.stdin.read()


def _bridge_line(case: Case, place: str) -> str:
    return f"idle_bridge: {case.bridge.format(place) if place else case.bridge}"


def _again_and_again(act: Callable[[], object], over: threading.Event) -> None:
    while not over.wait(PERIOD_SECONDS):
        act()


def _send(name: str, place: str) -> None:
    """Send to a manager from another process."""
    from uoarm import RobotManager  # noqa: PLC0415
    from uoarm.config import loads  # noqa: PLC0415

    case = CASES[name]
    with (
        RobotManager(loads(_robot(_bridge_line(case, place), case.sends))) as robot,
        robot.request("idle") as connection,
    ):
        print("ready", flush=True)
        _again_and_again(lambda: connection.send(case.message), threading.Event())


if __name__ == "__main__":
    sys.exit(main())
