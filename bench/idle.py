"""What a manager costs while little happens: processor time and wake-ups of its threads.

    python -m bench.idle            the table: each plugin with an open connection
    python -m bench.idle ros2 mqtt  some of it, with the threads that wake most

First nothing happens, then ten times a second a message of some 100 octets comes, or a call of as
much goes. A loop that turned for nothing would show in one of both. Each manager runs in a process
of its own; what it is connected to is another one and not counted. A wake-up is a thread that
waited and was given a processor again.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

from attrs import frozen
from typing_extensions import TypedDict

from bench.tables import print_table

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
_ECHO = 'service: {endpoint: ["bench.idle:echo"]}'


class Peers(ExitStack):
    """What a manager is connected to.

    Attributes:
        programs: those that run, the latest last.
    """

    def __init__(self) -> None:
        super().__init__()
        self.programs: list[subprocess.Popen[str]] = []


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


class Text(TypedDict):
    """What is called with."""

    text: str


def echo(message: Text) -> Text:
    """Be a service."""
    return message


def _program(stack: Peers, *words: str, says: str = "") -> str:
    """Run a program until the end of the stack; return what it says first, as far as it fits."""
    process = subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
    stack.programs.append(process)
    stack.callback(process.wait)
    stack.callback(process.send_signal, signal.SIGTERM)
    assert process.stdout is not None
    if not says:
        return ""
    for line in process.stdout:
        if found := re.search(says, line):
            return found.group(1)
    raise RuntimeError(f"{words[0]} does not say {says!r}")


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return int(free.getsockname()[1])


def _listening(stack: Peers, port: int, *words: str) -> str:
    _program(stack, *words)
    until = time.monotonic() + _END_SECONDS
    while time.monotonic() < until:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
            return f"127.0.0.1:{port}"
        time.sleep(0.05)
    raise RuntimeError(f"{words[0]} does not listen")


def _mosquitto(stack: Peers) -> str:
    port = _free_port()
    program = shutil.which("mosquitto") or "/usr/sbin/mosquitto"
    return "mqtt://" + _listening(stack, port, program, "-p", str(port))


def _vehicle(stack: Peers) -> str:
    url = _mosquitto(stack)
    _program(stack, sys.executable, "-c", _VEHICLE, url, says="(ready)")
    return url


def _master(stack: Peers) -> str:
    port = _free_port()
    return "http://" + _listening(stack, port, "rosmaster", "--core", "-p", str(port))


def _component(stack: Peers) -> str:
    from uoarm_rtm.nameserver import NameServer  # noqa: PLC0415

    address: str = stack.enter_context(NameServer()).address
    _program(stack, sys.executable, "-m", "bench.rtm_ports", "serve", address, says="(ready)")
    return address


def _device(stack: Peers) -> str:
    code = "from uoarm_rocos._command import main; main()"
    words = (sys.executable, "-u", "-c", code, "simulate", "robot", "--tcp", "0")
    return _program(stack, *words, says=r"(tcp://\S+)")


def _manager(stack: Peers) -> str:
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
    file = folder / "robot.yaml"
    text = _robot("idle_bridge: {plugin: python}", _ECHO) + "export: {local: [idle]}\n"
    file.write_text(text, encoding="utf-8")
    words = (sys.executable, "-u", "-m", "uoarm", "serve", str(file), "--port", "0")
    return _program(stack, *words, says=r"(ws://\S+?)/? ")


CASES = {
    "memory": Case("{plugin: memory}", "output: {endpoint: [idle]}"),
    "host": Case("{plugin: python, host: true}", _ECHO),
    "server": Case("{plugin: memory}", "output: {endpoint: [idle]}", serves=("/",)),
    "rosbridge server": Case(
        "{plugin: memory}", "output: {endpoint: [idle]}", serves=("/rosbridge",)
    ),
    "foxglove": Case("{plugin: memory}", "output: {endpoint: [idle]}", serves=("/foxglove",)),
    "mcp": Case("{plugin: python}", _ECHO, serves=("", "mcp")),
    "recorder": Case("{plugin: memory}", "output: {endpoint: [idle]}", records=True),
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
            row, threads = _measured(name)
        except (OSError, RuntimeError, ImportError, ValueError) as error:
            print(f"no row for {name}: {error}", file=sys.stderr)
            continue
        rows.append((name, *row))
        if sys.argv[1:]:
            print(*threads, sep="\n")
    columns = (
        "manager with", "CPU % of a core", "wake-ups a second",
        "with 10 messages a second: CPU %", "wake-ups", "load",
    )  # fmt: skip
    print_table("idle managers", columns, rows)
    return 0


def _measured(name: str) -> tuple[tuple[str, ...], list[str]]:
    case = CASES[name]
    with Peers() as stack:
        place = case.peer(stack) if case.peer is not None else ""
        words = (sys.executable, "-m", "bench.idle", "--run", name, place)
        process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        stack.callback(process.communicate)
        assert process.stdout is not None
        assert process.stdin is not None
        line = process.stdout.readline()
        if not line:
            raise RuntimeError("it did not start")
        names = json.loads(line)
        idle, idle_threads = _cost(process.pid, names)
        process.stdin.write("go\n")
        process.stdin.flush()
        if case.peer is _vehicle:
            stack.programs[-1].send_signal(signal.SIGUSR1)
        if case.sends:
            words = (sys.executable, "-m", "bench.idle", "--send", name, place)
            _program(stack, *words, says="(ready)")
        line = process.stdout.readline()
        if not line:
            raise RuntimeError("nothing came to it")
        busy, busy_threads = _cost(process.pid, json.loads(line))
    row = (*idle, *busy, f"{os.getloadavg()[0]:.1f}")
    return row, ["idle:", *idle_threads, "ten messages a second:", *busy_threads]


def _cost(process: int, names: dict[str, str]) -> tuple[tuple[str, str], list[str]]:
    """Return what a manager takes for a while, and which threads wake most."""
    time.sleep(SETTLE_SECONDS)
    before, began = _threads(_family(process)), time.monotonic()
    time.sleep(SECONDS)
    after, seconds = _threads(_family(process)), time.monotonic() - began
    changes = {
        thread: tuple(
            now - then for now, then in zip(found, before.get(thread, (0, 0)), strict=True)
        )
        for thread, found in after.items()
    }
    computed, woken = (sum(change[kind] for change in changes.values()) for kind in (0, 1))
    most = sorted(changes, key=lambda thread: -changes[thread][1])[:8]
    listed = [
        f"{names.get(str(thread), _comm(thread))}: {changes[thread][1] / seconds:.1f} wake-ups a "
        f"second, {changes[thread][0] / seconds / 1e6:.2f} ms"
        for thread in most
    ]
    return (f"{computed / seconds / 1e7:.2f}", f"{woken / seconds:.1f}"), listed


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


def _comm(thread: int) -> str:
    with suppress(OSError):
        return Path(f"/proc/{thread}/comm").read_text(encoding="utf-8").strip()
    return "ended"


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
                _program(stack, sys.executable, "-c", _CLIENT, url, *_ASKS.get(path, ()))
        print(json.dumps(_names()), flush=True)
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
        print(json.dumps(_names()), flush=True)
        sys.stdin.read()


def _bridge_line(case: Case, place: str) -> str:
    return f"idle_bridge: {case.bridge.format(place) if place else case.bridge}"


def _names() -> dict[int | None, str]:
    return {thread.native_id: thread.name for thread in threading.enumerate()}


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
