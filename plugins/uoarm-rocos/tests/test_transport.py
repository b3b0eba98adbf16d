"""Octets cross real sockets and a real tty with the settings asked for; a cut line is an error."""

from __future__ import annotations

import socket
import termios
import threading
import time
from collections.abc import Callable
from contextlib import closing
from typing import Any

import pytest
import serial
import serial.rfc2217
from lines import LIMIT, PseudoTerminal, listening
from tests.processes import ForkedProgram  # type: ignore[import-not-found]
from uoarm_rocos._framing import LineError
from uoarm_rocos._options import LineOptions
from uoarm_rocos._transport import LineTransport, SerialTransport, transport_for


def read_until(transport: LineTransport, count: int) -> bytes:
    """Read so many octets, or fail at the limit."""
    found, end = b"", time.monotonic() + LIMIT
    while len(found) < count and time.monotonic() < end:
        found += transport.read()
    return found


@pytest.mark.parametrize("scheme", ["tcp", "socket"])
def test_octets_cross_a_socket_both_ways_until_it_is_cut(scheme: str) -> None:
    with listening() as (server, port):
        transport = transport_for(f"{scheme}://127.0.0.1:{port}", LineOptions())()
        transport.open(LIMIT)
        device = server.accept()[0]
        device.settimeout(LIMIT)
        transport.write(b"to device")
        assert device.recv(100) == b"to device"
        device.sendall(b"to host")
        assert read_until(transport, 7) == b"to host"
        assert transport.read() == b""
        device.close()
        with pytest.raises(LineError):
            read_until(transport, 1)
        transport.close()


def test_octets_cross_a_tty_until_the_cable_is_out() -> None:
    with PseudoTerminal() as device:
        transport = transport_for(device.path, LineOptions())()
        transport.open(LIMIT)
        transport.write(b"to device")
        assert device.read(9) == b"to device"
        device.write(bytes(range(256)))
        assert read_until(transport, 256) == bytes(range(256))
        device.cut()
        with pytest.raises(LineError):
            read_until(transport, 1)
        transport.close()


@pytest.mark.parametrize(
    ("settings", "speed", "flags"),
    [
        (LineOptions(19200, 8, "O", 1, xonxoff=True), termios.B19200, {"CS8", "PARODD", "IXON"}),
        (LineOptions(9600, 8, "N", 1), termios.B9600, {"CS8"}),
        (LineOptions(115200, 8, "E", 2), termios.B115200, {"CS8", "CSTOPB"}),
    ],
)
def test_the_tty_has_the_settings_asked_for(
    settings: LineOptions, speed: int, flags: set[str]
) -> None:
    with PseudoTerminal() as device:
        transport = SerialTransport(device.path, settings)
        transport.open(LIMIT)
        attributes: list[Any] = termios.tcgetattr(device)
        control, mode = attributes[2], attributes[0]
        assert attributes[4:6] == [speed, speed]
        assert control & termios.CSIZE == termios.CS8
        assert bool(control & termios.PARODD) == ("PARODD" in flags)
        assert bool(control & termios.CSTOPB) == ("CSTOPB" in flags)
        assert bool(mode & termios.IXON) == ("IXON" in flags)
        transport.close()


def test_parity_is_asked_of_the_port(monkeypatch: pytest.MonkeyPatch) -> None:
    """Linux keeps PARENB off on a pseudo-terminal, so the flag is seen on its way there."""
    asked: list[Any] = []
    real = termios.tcsetattr

    def seen(fd: int, when: int, attributes: list[Any]) -> None:
        asked.append(attributes[2])
        real(fd, when, attributes)

    monkeypatch.setattr(termios, "tcsetattr", seen)
    with PseudoTerminal() as device:
        transport = SerialTransport(device.path, LineOptions(19200, 8, "O"))
        transport.open(LIMIT)
        transport.close()
    assert asked
    assert asked[-1] & termios.PARENB
    assert asked[-1] & termios.PARODD


def test_a_line_with_parity_is_opened_again() -> None:
    with PseudoTerminal() as device:
        for _ in range(3):
            transport = SerialTransport(device.path, LineOptions(19200, 8, "O"))
            transport.open(LIMIT)
            device.write(b"here")
            assert read_until(transport, 4) == b"here"
            transport.close()


@pytest.mark.filterwarnings("ignore:set(Daemon|Name):DeprecationWarning")  # inside pyserial
def test_rfc2217_works() -> None:
    with listening() as (server, port):
        thread = threading.Thread(target=serve_rfc2217, args=(server,))
        thread.start()
        transport = transport_for(f"rfc2217://127.0.0.1:{port}", LineOptions(19200))()
        transport.open(LIMIT)
        transport.write(b"there and back")
        assert read_until(transport, 14) == b"there and back"
        transport.close()
        thread.join(LIMIT)
        assert not thread.is_alive()


class _Answers:
    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection

    def write(self, data: bytes) -> None:
        self._connection.sendall(data)


def serve_rfc2217(server: socket.socket) -> None:
    """Serve a port that echoes to one client, with pyserial's own server side."""
    connection = server.accept()[0]
    connection.settimeout(0.02)
    with closing(connection), closing(serial.serial_for_url("loop://", timeout=0)) as port:
        manager = serial.rfc2217.PortManager(
            port,  # type: ignore[arg-type]  # the stub means its own Serial
            _Answers(connection),  # type: ignore[arg-type]  # anything with write
        )
        while True:
            data = port.read(1000)
            if data:
                connection.sendall(b"".join(manager.escape(data)))
            try:
                received = connection.recv(1000)
            except TimeoutError:
                continue
            except OSError:
                return
            if not received:
                return
            port.write(b"".join(manager.filter(received)))


@pytest.mark.parametrize("url", ["tcp://127.0.0.1:1", "/dev/not-there", "socket://127.0.0.1:1"])
def test_what_cannot_be_reached_is_a_line_error_and_can_be_closed(url: str) -> None:
    transport = transport_for(url, LineOptions())()
    with pytest.raises(LineError, match=r"not-there|127"):
        transport.open(LIMIT)
    transport.close()


@pytest.mark.parametrize(
    "url", ["tcp://", "tcp://host", "tcp://host:x", "tcp://:1", "tcp://h:70000"]
)
def test_a_tcp_url_without_host_or_port_is_refused(url: str) -> None:
    with pytest.raises(ValueError, match="tcp://host:port"):
        transport_for(url, LineOptions())


def test_a_device_that_takes_nothing_is_a_line_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uoarm_rocos._transport._WRITE_SECONDS", 0.1)
    with listening() as (server, port):
        transport = transport_for(f"tcp://127.0.0.1:{port}", LineOptions())()
        transport.open(LIMIT)
        device = server.accept()[0]
        with pytest.raises(LineError, match="writing"):
            flood(transport.write)
        transport.close()
        device.close()


def flood(write: Callable[[bytes], None]) -> None:
    for _ in range(1000):
        write(bytes(100_000))


FORKED = """
import sys
from uoarm_rocos._options import LineOptions
from uoarm_rocos._transport import transport_for

transport = transport_for(sys.argv[1], LineOptions())()
transport.open(60)
"""


@pytest.mark.parametrize("scheme", ["tcp", "socket"])
def test_a_child_that_is_forked_holds_no_line_of_its_parent(scheme: str) -> None:
    """A device that serves one at a time serves the next."""
    with socket.create_server(("127.0.0.1", 0)) as device:
        address = f"{scheme}://127.0.0.1:{device.getsockname()[1]}"
        with ForkedProgram(FORKED, address) as forked:
            assert forked.read() == "forked"
            with device.accept()[0] as line:
                line.setblocking(False)
                with pytest.raises(BlockingIOError):
                    line.recv(1)  # the child ended nothing of its parent's
                forked.kill_parent()
                line.settimeout(LIMIT)
                assert line.recv(1) == b""


def test_a_child_that_is_forked_holds_no_port_of_its_parent() -> None:
    """A port belongs to who opened it, until that ends."""
    with PseudoTerminal() as device, ForkedProgram(FORKED, device.path) as forked:
        assert forked.read() == "forked"
        port = transport_for(device.path, LineOptions())()
        with pytest.raises(LineError, match="lock"):
            port.open(LIMIT)
        forked.kill_parent()
        port.open(LIMIT)
        port.close()
