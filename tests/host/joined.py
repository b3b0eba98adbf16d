"""Hosts that join from "another machine": processes of this one, over loopback or a namespace."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.host import hosted
from tests.processes import states, thread_names
from typing_extensions import Self

from uoarm._support.certificates import Authority
from uoarm.testing import patience, wait

ROBOT = """
version: 1
hosts: {{listen: "tls/{address}:{port}", certificates: certificates, silence: {silence}}}
failover: {failover}
bridges:
  far: {{plugin: python, host: {{machine: arm, silence: {silence}, start: {start}}}}}
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
SPARE = """
      - {name: spare, bridge: near, priority: 1, output: {endpoint: ["hosted_parts:forever"]}}
"""


def robot(
    folder: Path,
    port: int,
    *,
    address: str = "127.0.0.1",
    spare: bool = False,
    failover: str = "{}",
    silence: float | None = None,
    start: float | None = None,
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
        silence=silence or patience(),
        start=start or patience(),
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
        patient: bool = True,
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
                env={**os.environ, **(hosted.PATIENT if patient else {})},
            )

    @property
    def log(self) -> str:
        return self._log.read_text()

    @property
    def process(self) -> int:
        return self._process.pid

    @property
    def runs(self) -> bool:
        return self._process.poll() is None

    def holdings(self) -> tuple[int, int]:
        """Return how many threads of Python's it has, and how many descriptors. Linux."""
        main, *others = thread_names(self._process.pid)
        return 1 + others.count(main), sum(
            1 for _ in Path(f"/proc/{self._process.pid}/fd").iterdir()
        )

    def signal(self, number: signal.Signals) -> None:
        """Send a signal; for SIGSTOP return when all its threads stand."""
        os.kill(self._process.pid, number)
        if number == signal.SIGSTOP:
            wait(lambda: set(states(self._process.pid)) == {"T"})

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

    def __exit__(self, *_: object) -> None:
        self.end()
