"""Devices with an XML catalogue over TCP and a tty: service round trips beside the bare line."""

from __future__ import annotations

import os
import signal
import socket
import sys
import tty
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

from bench.tables import microseconds, print_table, row
from bench.turns import module, running

TEXT = "a sentence of usual length, said to a robot"
CALLS = 2000
_WARMING = 100
SIMULATED = (
    *(sys.executable, "-u", "-c", "from uoarm_rocos._command import main; main()"),
    *("simulate", "robot"),
)


def main() -> int:
    """Print the tables; 0 also when the plugin is not installed."""
    try:
        import uoarm_rocos  # noqa: F401, PLC0415
    except ImportError as error:
        print(f"no line table: {error}", file=sys.stderr)
        return 0
    if sys.argv[1:2] == ["echo"]:
        return _echo(sys.argv[2])
    _round_trips()
    return 0


def _round_trips() -> None:
    rows = [
        row("bare codec: request and reply written and read", microseconds(_codec())),
        row("bare codec: 200 numbers, checked at both ends", microseconds(_numbers())),
    ]
    for kind in ("tcp", "pty"):
        with _echoing(kind) as ask:
            rows.append(row(f"bare line, {kind}: the same octets there and back", _timed(ask)))
        with _robot(kind) as (call, device):
            before = [_computed(process) for process in (os.getpid(), device)]
            took = _timed(call)
            ours, its = (
                (_computed(process) - start) / (_WARMING + CALLS)
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
    return microseconds(action, repeat=CALLS)


def _codec() -> Callable[[], object]:
    from uoarm_rocos import XmlCodec  # noqa: PLC0415
    from uoarm_rocos._catalogue import CallMessage, ResultMessage  # noqa: PLC0415

    codec, values = XmlCodec(), {"text": TEXT}

    def once() -> None:
        codec.read(codec.write(CallMessage(1, 1, "echo", values)))
        codec.read(codec.write(ResultMessage(1, 1, values)))

    return once


def _numbers() -> Callable[[], object]:
    from uoarm_rocos import XmlCodec  # noqa: PLC0415
    from uoarm_rocos._catalogue import (  # noqa: PLC0415
        DataMessage,
        ListField,
        NamedField,
        NumberField,
    )
    from uoarm_rocos._structure import fit  # noqa: PLC0415

    codec, fields = XmlCodec(), {"ranges": NamedField(ListField(NumberField()))}
    scan = {"ranges": [0.37 * number for number in range(200)]}

    def once() -> None:
        written = codec.write(DataMessage(1, 1, fit(fields, scan, "sent"), None))
        read = codec.read(written)
        assert isinstance(read, DataMessage)
        fit(fields, read.values, "received")

    return once


@contextmanager
def _echoing(kind: str) -> Iterator[Callable[[], object]]:
    """A process that sends back what it gets; one round of a request's length."""
    from uoarm_rocos import XmlCodec  # noqa: PLC0415
    from uoarm_rocos._catalogue import CallMessage  # noqa: PLC0415

    octets = XmlCodec().write(CallMessage(1, 1, "echo", {"text": TEXT}))
    with running(module("bench.rocos_line", "echo", kind), signal.SIGTERM) as child:
        where = child.said()
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
    missing = len(octets)
    while missing:
        received = len(read(missing))
        assert received, "the line has ended"
        missing -= received


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
def _robot(kind: str) -> Iterator[tuple[Callable[[], object], int]]:
    """A call to a simulated robot, and the id of the robot's process."""
    from uoarm.bridge import Registry  # noqa: PLC0415
    from uoarm.model import BridgeSpec, Endpoint, Role  # noqa: PLC0415

    where = ("--tcp", "0") if kind == "tcp" else ("--pty",)
    with running((*SIMULATED, *where), signal.SIGINT) as device:
        options = {"devices": {"robot": {"url": device.said()}}}
        bridge = Registry().create(BridgeSpec("rocos", "rocos", options))
        echo = Endpoint("rocos", "robot", Role.SERVICE, ("robot", "echo"))
        bridge.describe(echo)
        yield lambda: bridge.call(echo, {"text": TEXT}), device.process.pid
        bridge.close()


if __name__ == "__main__":
    sys.exit(main())
