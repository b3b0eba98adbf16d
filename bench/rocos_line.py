"""Devices over TCP and a tty: round trips, decoding, an oximeter's way to the application.

`python -m bench.rocos_line soak 10` has an oximeter send 60 frames a second for ten minutes and
counts what is lost.
"""

from __future__ import annotations

import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

from bench.tables import at, microseconds, print_table, row

TEXT = "a sentence of usual length, said to a robot"
FRAMES = 2000
_WARMING = 100
_CALLS = _WARMING + FRAMES


def main() -> int:
    """Print the tables; 0 also when the plugin is not installed."""
    try:
        import uoarm_rocos  # noqa: F401, PLC0415
    except ImportError as error:
        print(f"no line table: {error}", file=sys.stderr)
        return 0
    if sys.argv[1:2] == ["echo"]:
        return _echo(sys.argv[2])
    if sys.argv[1:2] == ["soak"]:
        return _soak(float(sys.argv[2]))
    _round_trips()
    _decoding()
    _latency()
    return 0


def _round_trips() -> None:
    rows = [row("bare codec: request and reply written and read", microseconds(_codec()))]
    for kind in ("tcp", "pty"):
        with _echoing(kind) as ask:
            rows.append(row(f"bare line, {kind}: the same octets there and back", _timed(ask)))
        with _robot(kind) as (call, device):
            before = [_computed(process) for process in (os.getpid(), device)]
            took = _timed(call)
            ours, its = (
                (_computed(process) - start) / _CALLS
                for process, start in zip((os.getpid(), device), before, strict=True)
            )
            note = f"processor time: bridge {ours:.0f}, device {its:.0f}"
            rows.append(row(f"uoarm bridge, {kind}", took, note))
    print_table("Service round trip of a device (us)", ("way", "median", "p99", ""), rows)


def _computed(process: int) -> float:
    """Return the microseconds that the threads of a process have computed; Linux only."""
    threads = Path(f"/proc/{process}/task").glob("*/schedstat")
    return sum(int(thread.read_text().split()[0]) for thread in threads) / 1000


def _timed(action: Callable[[], object]) -> list[float]:
    microseconds(action, repeat=_WARMING)
    return microseconds(action, repeat=FRAMES)


def _codec() -> Callable[[], object]:
    from uoarm_rocos import XmlCodec  # noqa: PLC0415
    from uoarm_rocos._messages import Call, Result  # noqa: PLC0415

    codec, values = XmlCodec(), {"text": TEXT}

    def once() -> None:
        codec.read(codec.write(Call(1, 1, "echo", values)))
        codec.read(codec.write(Result(1, 1, values)))

    return once


@contextmanager
def _echoing(kind: str) -> Iterator[Callable[[], object]]:
    """A process that sends back what it gets; one round of a request's length."""
    from uoarm_rocos import XmlCodec  # noqa: PLC0415
    from uoarm_rocos._messages import Call  # noqa: PLC0415

    octets = XmlCodec().write(Call(1, 1, "echo", {"text": TEXT}))
    command = [sys.executable, "-m", "bench.rocos_line", "echo", kind]
    with _ended_by(signal.SIGTERM, command) as (where, _):
        if kind == "tcp":
            with closing(socket.create_connection(("127.0.0.1", int(where)))) as line:
                line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                yield lambda: _ask(line.sendall, line.recv, octets)
        else:
            port = os.open(where, os.O_RDWR | os.O_NOCTTY)
            yield lambda: _ask(
                lambda data: os.write(port, data), lambda n: os.read(port, n), octets
            )
            os.close(port)


def _ask(write: Callable[[bytes], object], read: Callable[[int], bytes], octets: bytes) -> None:
    write(octets)
    _whole(read, len(octets))


def _whole(read: Callable[[int], bytes], count: int) -> None:
    while count:
        came = len(read(count))
        assert came, "the line has ended"
        count -= came


def _echo(kind: str) -> int:
    if kind == "tcp":
        with closing(socket.create_server(("127.0.0.1", 0))) as server:
            print(server.getsockname()[1], flush=True)
            line = server.accept()[0]
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while data := line.recv(4096):
                line.sendall(data)
        return 0
    device, line_end = os.openpty()
    tty.setraw(line_end)
    print(os.ttyname(line_end), flush=True)
    while True:
        os.write(device, os.read(device, 4096))


@contextmanager
def _simulated(*words: str) -> Iterator[tuple[str, int]]:
    command = [sys.executable, "-c", "from uoarm_rocos._command import main; main()", "simulate"]
    with _ended_by(signal.SIGINT, [*command, *words]) as url_and_process:
        yield url_and_process


@contextmanager
def _ended_by(number: signal.Signals, command: list[str]) -> Iterator[tuple[str, int]]:
    """A process for as long as it is needed: the first line that it prints, and its id."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        try:
            yield process.stdout.readline().strip(), process.pid
        finally:
            process.send_signal(number)


def _bridge(**devices: dict[str, object]) -> Any:
    from uoarm.bridge import Registry  # noqa: PLC0415
    from uoarm.model import BridgeSpec  # noqa: PLC0415

    return Registry().create(BridgeSpec("rocos", "rocos", {"devices": devices}))


def _endpoint(device: str, api: str, role: str) -> Any:
    from uoarm.model import Endpoint, Role  # noqa: PLC0415

    return Endpoint("rocos", device, Role(role), (device, api))


@contextmanager
def _robot(kind: str) -> Iterator[tuple[Callable[[], object], int]]:
    """A call to a simulated robot, and the id of the robot's process."""
    words = ("--tcp", "0") if kind == "tcp" else ("--pty",)
    with _simulated("robot", *words) as (url, process):
        bridge = _bridge(robot={"url": url})
        echo = _endpoint("robot", "echo", "service")
        bridge.describe(echo)
        yield lambda: bridge.call(echo, {"text": TEXT}), process
        bridge.close()


def _decoding() -> None:
    from uoarm_rocos import StuffedFramer, XmlCodec  # noqa: PLC0415
    from uoarm_rocos._messages import Data  # noqa: PLC0415
    from uoarm_rocos.devices._contec import ContecDecoder, contec_frame  # noqa: PLC0415
    from uoarm_rocos.devices._nonin import Nonin2Decoder, nonin2_packet  # noqa: PLC0415

    codec, framer, count = XmlCodec(), StuffedFramer(), 100
    odometry = {"x": 1.25, "y": -0.5, "heading": 0.125}
    stuffed = b"".join(framer.frame(codec.write(Data(n, 1, odometry))) for n in range(count))
    contec = contec_frame(pulse=72, spo2=97, wave=64, strength=5) * count
    nonin = b"".join(nonin2_packet([9] * 25, rate=72, spo2=97) * (count // 25))
    ways: dict[str, Callable[[], int]] = {
        "profile over serial: frame, CRC, XML": lambda: len(
            [codec.read(one) for one in StuffedFramer().feed(stuffed)]
        ),
        "Contec CMS50D+": lambda: len(ContecDecoder().feed(contec)),
        "Nonin format 2": lambda: len(Nonin2Decoder().feed(nonin)),
    }
    rows = []
    for name, way in ways.items():
        assert way() == count
        took = at(sorted(_processor_time(way) for _ in range(200)), 0.5) / count
        rows.append((name, f"{took:.1f}", f"{1e6 / took:,.0f}"))
    print_table("Decoding of messages, processor time", ("what", "us each", "a second"), rows)


def _processor_time(way: Callable[[], object]) -> float:
    start = time.process_time_ns()
    way()
    return (time.process_time_ns() - start) / 1000


def _latency() -> None:
    """From the octets' way into the line to the application, and the line alone."""
    from uoarm_rocos.devices._contec import contec_frame  # noqa: PLC0415

    from uoarm._control import RobotManager  # noqa: PLC0415

    device, line = os.openpty()
    tty.setraw(line)
    path, frame = os.ttyname(line), contec_frame(pulse=72, spo2=97, wave=64, strength=5)

    def bare() -> None:
        os.write(device, frame)
        _whole(lambda n: os.read(line, n), len(frame))

    rows = [row("bare line: five octets into a tty and out of it", _timed(bare))]
    text = f"""
version: 1
bridges:
  rocos:
    plugin: rocos
    options: {{devices: {{clip: {{driver: contec-cms50dplus, url: "{path}"}}}}}}
functions:
  pulseOximetry:
    components:
      - {{name: clip, bridge: rocos, output: {{endpoint: [clip, pulseOximetry]}}}}
"""
    came, stop = threading.Event(), threading.Event()
    feeding = threading.Thread(target=_feed, args=(device, frame, stop), daemon=True)
    feeding.start()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "robot.yaml"
        file.write_text(text)
        manager = RobotManager.from_file(file)
    with manager as robot, robot.request("pulseOximetry") as flow:
        stop.set()
        feeding.join()
        flow.subscribe(lambda _: came.set())
        time.sleep(0.3)

        def chain() -> None:
            came.clear()
            os.write(device, frame)
            assert came.wait(5.0)

        rows.append(row("oximeter to application, through the manager", _timed(chain)))
    os.close(device)
    os.close(line)
    print_table("An oximeter's message (us; the paper: 1 ms)", ("way", "median", "p99", ""), rows)


def _feed(device: int, frame: bytes, stop: threading.Event) -> None:
    while not stop.wait(0.02):
        if select.select([], [device], [], 0)[1]:
            os.write(device, frame)


def _soak(minutes: float) -> int:
    with _simulated("oximeter", "--pty") as (url, _):
        bridge = _bridge(clip={"driver": "contec-cms50dplus", "url": url})
        endpoint = _endpoint("clip", "pulseOximetry", "output")
        got: list[float] = []
        structure = bridge.describe(endpoint).message
        source = bridge.open_source(endpoint, structure, lambda _: got.append(time.monotonic()))
        time.sleep(minutes * 60)
        source.close()
        facts, counted = dict(source.facts()), len(got)
        bridge.close()
    lasted = got[-1] - got[0]
    due = round(lasted * 60) + 1
    gap = max(two - one for one, two in pairwise(got))
    print(
        f"{lasted:.1f} s: {counted} messages of {due} due, longest gap {gap * 1000:.0f} ms, {facts}"
    )
    return int(abs(counted - due) > 2)


if __name__ == "__main__":
    sys.exit(main())
