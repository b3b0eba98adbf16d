"""Hosts that join from "another machine": processes of this one, over loopback or a namespace."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from random import SystemRandom
from types import TracebackType

from tests.host import hosted
from typing_extensions import Self

from uoarm._certificates import Authority
from uoarm.testing import patience, slowness, wait

ROBOT = """
version: 1
hosts: {{listen: "tls/{address}:{port}", certificates: certificates, silence: {silence}}}
failover: {failover}
bridges:
  far: {{plugin: python, host: {{machine: arm, silence: {silence}}}}}
  near: {{plugin: python}}
functions:
  ticks:
    components:
      - {{name: ticker, bridge: far, priority: 2, output: {{endpoint: ["hosted_parts:forever"]}}}}
{others}
  numbers:
    components: [{{name: counter, bridge: far, output: {{endpoint: ["hosted_parts:count"]}}}}]
  doubled:
    components:
      - name: doubler
        bridge: far
        input: {{from: numbers, endpoint: ["hosted_parts:double"]}}
        output: {{endpoint: ["hosted_parts:double"]}}
  where:
    components:
      - {{name: asker, bridge: far, service: {{endpoint: ["hosted_parts:process_id"]}}}}
"""
_GIVEN_PORTS = Path("/proc/sys/net/ipv4/ip_local_port_range")
_LOWEST_PORT = 10_000
SPARE = """
      - {name: spare, bridge: near, priority: 1, output: {endpoint: ["hosted_parts:forever"]}}
"""


def free_port() -> int:
    """Return a port that is free, and that the system gives to nobody who does not ask for it.

    One that the system chose itself may be given to the next connection of any process before
    the test listens on it.
    """
    first_given = 32768
    with suppress(OSError):
        first_given = int(_GIVEN_PORTS.read_text().split()[0])
    for port in SystemRandom().sample(range(_LOWEST_PORT, max(first_given, 2 * _LOWEST_PORT)), 100):
        with socket.socket() as one, suppress(OSError):
            one.bind(("127.0.0.1", port))
            return port
    raise AssertionError("none of a hundred ports is free")


def robot(
    folder: Path,
    port: int,
    *,
    address: str = "127.0.0.1",
    spare: bool = False,
    failover: str = "{}",
    silence: float | None = None,
) -> Path:
    """Write a robot with bridges on machine `arm`, its components, and certificates."""
    (folder / "hosted_parts.py").write_text(hosted.COMPONENTS)
    authority = Authority.of(folder / "certificates")
    authority.certify_manager([address], 1)
    authority.certify_machine("arm", 1)
    authority.certify_machine("leg", 1)
    text = ROBOT.format(
        port=port,
        address=address,
        failover=failover,
        silence=silence or 3 * slowness(),
        others=SPARE if spare else "",
    )
    file = folder / "robot.yaml"
    file.write_text(text)
    return file


class Joined:
    """A process of `uoarm host --join`, ended with the block."""

    def __init__(
        self,
        folder: Path,
        place: str,
        *more: str,
        machine: str = "arm",
        certificates: Path | None = None,
        within: Sequence[str] = (),
    ) -> None:
        self._log = folder / f"host-{machine}.log"
        command = ["uoarm", "host", "--join", place, "--machine", machine, *more]
        places = ["--certificates", str(certificates or folder / "certificates")]
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                [*within, sys.executable, "-m", *command, *places, "--modules", str(folder)],
                stdout=log,
                stderr=log,
                stdin=subprocess.DEVNULL,
            )

    @property
    def log(self) -> str:
        return self._log.read_text()

    @property
    def runs(self) -> bool:
        return self._process.poll() is None

    def holdings(self) -> tuple[int, int]:
        """Return how many threads of Python's it has, and how many descriptors. Linux."""
        home = Path(f"/proc/{self._process.pid}")
        names = [(one / "comm").read_text() for one in (home / "task").iterdir()]
        main = (home / "comm").read_text()
        return names.count(main), sum(1 for _ in (home / "fd").iterdir())

    def signal(self, number: signal.Signals) -> None:
        """Send a signal; for SIGSTOP return when all its threads stand."""
        os.kill(self._process.pid, number)
        if number == signal.SIGSTOP:
            wait(self._stands)

    def _stands(self) -> bool:
        tasks = Path(f"/proc/{self._process.pid}/task").iterdir()
        return all((one / "stat").read_text().rpartition(") ")[2][0] == "T" for one in tasks)

    def end(self) -> int:
        """Ask it to end, and return its exit status."""
        if self.runs:
            self.signal(signal.SIGCONT)
            self._process.terminate()
        try:
            return self._process.wait(patience())
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait(patience())
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.end()
