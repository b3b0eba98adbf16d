"""A naming service for programs and tests: omniNames, without any other installation.

It listens on loopback and ends with its starter, where that is killed on Linux only. Importing this
module imports no middleware.

with NameServer() as names:
    print(names.address)
"""

from __future__ import annotations

import os
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue

from typing_extensions import Self

from uoarm.bridge import on_failure, reason_of
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, ListenError
from uoarm_rtm._compiler import omniorb_programs

__all__ = ["NameServer", "nameserver_command"]

_START_SECONDS = 10.0
_STOP_SECONDS = 3.0
_TRIES = 5


def nameserver_command(
    port: int, address: str, folder: Path, log: str = "/dev/null"
) -> tuple[str, ...]:
    """Return the command line of omniNames, for a caller that starts the process itself.

    Args:
        port: TCP port.
        address: interface to listen on.
        folder: existing folder where it keeps its names between runs.
        log: file that takes its errors.
    """
    programs = omniorb_programs()
    program = str(programs / "omniNames") if programs is not None else "omniNames"
    kept = ("-start", str(port), "-always", "-datadir", str(folder), "-errlog", log)
    return (program, *kept, "-ORBendPoint", f"giop:tcp:{address}:{port}")


class NameServer:
    """A running omniNames; a context manager that ends it.

    Args:
        port: TCP port; 0 for any that is free, in up to five tries.
        address: interface to listen on.
        folder: where it keeps its names between runs, made if need be; None: nowhere.

    Raises:
        BridgeError: UNAVAILABLE when omniNames is not there or ends at once, or the folder cannot
            be made.
        BridgeTimeoutError: it does not listen within 10 s.
        ListenError: it was to find a free port, and the address is none of this machine.
    """

    def __init__(
        self, port: int = 0, address: str = "127.0.0.1", folder: Path | None = None
    ) -> None:
        self._maker = os.getpid()
        if folder is not None:
            try:
                folder.mkdir(parents=True, exist_ok=True)  # without it omniNames just ends
            except OSError as error:
                text = f"the folder of its names cannot be made: {reason_of(error)}"
                raise BridgeError(text, FailureReason.UNAVAILABLE) from error
        kept = folder if folder is not None else Path(tempfile.mkdtemp(prefix="uoarm-names-"))
        self._own = None if folder is not None else kept
        tries = 1 if port else _TRIES
        with on_failure(self._forget):
            for left in reversed(range(tries)):
                self.port = port or _free_port(address)
                ended = "another naming service is there"
                # Whose answers would pass for those of ours, until that has found no port.
                if not _is_served(address, self.port):
                    self.process = _start(nameserver_command(self.port, address, kept))
                    if _serves_soon(self.process, address, self.port):
                        break
                    ended = f"omniNames ended with {self.process.returncode}"
                if not left:  # else another program took the port meanwhile: try the next
                    text = f"{ended}: is port {self.port} in use, the folder writable?"
                    raise BridgeError(text, FailureReason.UNAVAILABLE)
        self.address = f"corbaloc:iiop:{address}:{self.port}/NameService"

    def close(self) -> None:
        """End it; names that were kept nowhere are forgotten. Nothing in a forked child."""
        if os.getpid() != self._maker:
            return
        _end(self.process)
        self._forget()

    def _forget(self) -> None:
        if self._own is not None:
            shutil.rmtree(self._own, ignore_errors=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _start(command: tuple[str, ...]) -> subprocess.Popen[bytes]:
    started: SimpleQueue[subprocess.Popen[bytes] | Exception] = SimpleQueue()

    def run() -> None:
        try:
            process = subprocess.Popen(  # noqa: S603 - a program of our dependency
                _with_starter(command),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
        except Exception as error:  # noqa: BLE001 - raised where it is waited for
            started.put(error)
        else:
            started.put(process)
            process.wait()  # as it would end with this thread

    process: subprocess.Popen[bytes] | Exception
    try:
        threading.Thread(target=run, name="uoarm-rtm-names", daemon=True).start()
        process = started.get()
    except RuntimeError as error:  # the system gives no more threads
        process = error
    if isinstance(process, Exception):
        why = reason_of(process) if isinstance(process, OSError) else process
        text = f"omniNames cannot be started: {why}"
        raise BridgeError(text, FailureReason.UNAVAILABLE) from process
    return process


# The kernel ends it with the thread that started it, however that ends (prctl(2)).
_WITH_STARTER = """
import ctypes, os, signal, sys
ctypes.CDLL(None).prctl(1, signal.SIGTERM, 0, 0, 0)
if os.getppid() == int(sys.argv[1]):
    os.execv(sys.argv[2], sys.argv[2:])
"""


def _with_starter(command: tuple[str, ...]) -> tuple[str, ...]:
    """Return the command line of a process that ends when this one is killed; Linux only."""
    program = shutil.which(command[0])
    if sys.platform != "linux" or program is None:  # which is said as it is started
        return command
    own = (sys.executable, "-I", "-S", "-c", _WITH_STARTER, str(os.getpid()))
    return (*own, program, *command[1:])


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(_STOP_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _serves_soon(process: subprocess.Popen[bytes], address: str, port: int) -> bool:
    """Wait until it serves; False: it has ended. Ends it on any error."""
    deadline = time.monotonic() + _START_SECONDS
    with on_failure(_end, process):
        while process.poll() is None:
            if _is_served(address, port):
                return process.poll() is None
            if time.monotonic() > deadline:
                text = f"omniNames did not serve on {address}:{port} within 10 s"
                raise BridgeTimeoutError(text)
            time.sleep(0.01)
    return False


def _is_served(address: str, port: int) -> bool:
    with suppress(OSError):
        return _serves(address, port)
    return False


def _serves(address: str, port: int) -> bool:
    """Ask whether the root context is there, with a GIOP 1.0 LocateRequest of our own.

    It listens a moment before it serves; and the waiting process may have no ORB yet.
    """
    key = b"NameService"
    body = struct.pack("<II", 1, len(key)) + key
    with socket.create_connection((address, port), 1.0) as asking:
        asking.settimeout(1.0)
        asking.sendall(b"GIOP\x01\x00\x01\x03" + struct.pack("<I", len(body)) + body)
        reply = asking.recv(20, socket.MSG_WAITALL)
    # The status of a LocateReply: 0 unknown, 1 here, 2 elsewhere; its low byte is 1 or 2.
    return len(reply) == 20 and reply[7] == 4 and any(reply[16:20])  # noqa: PLR2004 - of GIOP


def _free_port(address: str) -> int:
    with socket.socket() as probe:
        try:
            probe.bind((address, 0))
        except OSError as error:
            raise ListenError(f"{address}:0", 0, error) from error
        port: int = probe.getsockname()[1]
        return port
