"""What a manager costs while nothing happens: processor time and wake-ups of its threads.

    python -m bench.idle            the table: each plugin with an open connection
    python -m bench.idle ros2 mqtt  some of it, with the threads that wake most

Each manager runs in a process of its own; what it is connected to is another one and not counted.
A wake-up is a thread that waited and was given a processor again.
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

from attrs import frozen

from bench.tables import print_table

SECONDS = 20.0
SETTLE_SECONDS = 5.0
_END_SECONDS = 20.0
_VEHICLE = """
import sys, time
from uoarm_vda5050.vehicle import Vehicle
with Vehicle(sys.argv[1], "uoa", "agv1") as vehicle:
    vehicle.set(position=(0.0, 0.0, 0.0, "floor"))
    print("ready", flush=True)
    time.sleep(3600)
"""
_ECHO = 'service: {endpoint: ["bench.idle:echo"]}'


@frozen
class Case:
    """A manager that is idle.

    Attributes:
        bridge: its line in the configuration; `{}` is the place of the peer.
        endpoint: of its function.
        peer: starts what it is connected to, and returns where that is.
        serves: front ends of the server before it, the first of which a client is connected to.
        records: whether the function is recorded.
    """

    bridge: str
    endpoint: str
    peer: Callable[[ExitStack], str] | None = None
    serves: tuple[str, ...] = ()
    records: bool = False


def echo(message: str) -> str:
    """Be a service."""
    return message


def _program(stack: ExitStack, *words: str, says: str = "") -> str:
    """Run a program until the end of the stack; return what it says first, as far as it fits."""
    process = subprocess.Popen(
        words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    )
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


def _listening(stack: ExitStack, port: int, *words: str) -> str:
    _program(stack, *words)
    until = time.monotonic() + _END_SECONDS
    while time.monotonic() < until:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
            return f"127.0.0.1:{port}"
        time.sleep(0.05)
    raise RuntimeError(f"{words[0]} does not listen")


def _mosquitto(stack: ExitStack) -> str:
    port = _free_port()
    program = shutil.which("mosquitto") or "/usr/sbin/mosquitto"
    return "mqtt://" + _listening(stack, port, program, "-p", str(port))


def _vehicle(stack: ExitStack) -> str:
    url = _mosquitto(stack)
    _program(stack, sys.executable, "-c", _VEHICLE, url, says="(ready)")
    return url


def _master(stack: ExitStack) -> str:
    port = _free_port()
    return "http://" + _listening(stack, port, "rosmaster", "--core", "-p", str(port))


def _component(stack: ExitStack) -> str:
    from uoarm_rtm.nameserver import NameServer  # noqa: PLC0415

    address: str = stack.enter_context(NameServer()).address
    _program(stack, sys.executable, "-m", "bench.rtm_ports", "serve", address, says="(ready)")
    return address


def _device(stack: ExitStack) -> str:
    code = "from uoarm_rocos._command import main; main()"
    words = (sys.executable, "-u", "-c", code, "simulate", "robot", "--tcp", "0")
    return _program(stack, *words, says=r"(tcp://\S+)")


def _manager(stack: ExitStack) -> str:
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
    ),
    "ros1": Case(
        "{{plugin: ros1, options: {{master: '{}'}}}}",
        "output: {endpoint: [/idle, std_msgs/String], options: {peer: optional}}",
        _master,
    ),
    "mqtt": Case(
        "{{plugin: mqtt, options: {{url: '{}'}}}}",
        "output: {endpoint: [idle], structure: {type: integer}}",
        _mosquitto,
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
    if sys.argv[1:2] == ["--run"]:
        _run(sys.argv[2], sys.argv[3])
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
    columns = ("manager with", "CPU % of a core", "wake-ups a second", "load")
    print_table("idle managers", columns, rows)
    return 0


def _measured(name: str) -> tuple[tuple[str, ...], list[str]]:
    case = CASES[name]
    with ExitStack() as stack:
        place = case.peer(stack) if case.peer is not None else ""
        words = (sys.executable, "-m", "bench.idle", "--run", name, place)
        process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        stack.callback(process.communicate)
        assert process.stdout is not None
        line = process.stdout.readline()
        if not line:
            raise RuntimeError("it did not start")
        names = json.loads(line)
        time.sleep(SETTLE_SECONDS)
        before, began = _threads(_family(process.pid)), time.monotonic()
        time.sleep(SECONDS)
        after, seconds = _threads(_family(process.pid)), time.monotonic() - began
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
    row = (f"{computed / seconds / 1e7:.2f}", f"{woken / seconds:.1f}", f"{os.getloadavg()[0]:.1f}")
    return row, listed


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
    """Be the manager until standard input ends."""
    from uoarm import RobotManager  # noqa: PLC0415
    from uoarm.config import loads  # noqa: PLC0415
    from uoarm.testing import MemoryBridge  # noqa: PLC0415

    case = CASES[name]
    line = f"idle_bridge: {case.bridge.format(place) if place else case.bridge}"
    memory = MemoryBridge("idle_bridge")
    memory.emitter("idle", {"type": "integer"})
    given = {"idle_bridge": memory} if "memory" in case.bridge else {}
    with ExitStack() as stack:
        robot = stack.enter_context(RobotManager(loads(_robot(line, case.endpoint)), bridges=given))
        stack.enter_context(robot.request("idle"))
        if case.records:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            stack.enter_context(robot.record("idle", path=folder / "idle.mcap"))
        if case.serves:
            from uoarm.server import ServerOptions, serve_in_thread  # noqa: PLC0415

            ports = dict.fromkeys(case.serves[1:], 0)
            options = ServerOptions(port=0, front_end_ports=ports)
            server = stack.enter_context(serve_in_thread(robot, options))
            if case.serves[0]:
                _program(
                    stack, sys.executable, "-m", "websockets",
                    f"ws://127.0.0.1:{server.ports[0]}{case.serves[0]}",
                )  # fmt: skip
        threads = {thread.native_id: thread.name for thread in threading.enumerate()}
        print(json.dumps(threads), flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    sys.exit(main())
