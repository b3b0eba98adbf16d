"""A desk behind a cable that loses packets and is cut: network namespaces, real processes."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TypedDict

import pytest
from tests.cables import Cable, laid_cable

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import ServerOptions, hash_token, make_token, serve_in_thread
from uoarm.testing import patience, wait

pytestmark = pytest.mark.needs("remote")
DESK = Path(__file__).parent / "desk_apart.py"
LIFETIME = 1.0
CUT = 10.0  # seconds without a packet
ROBOT = f"""
version: 1
bridges: {{python: {{}}}}
export: {{fleet: [drive, counter]}}
functions:
  drive:
    components:
      - name: base
        bridge: python
        input:
          endpoint: ["tests.server.test_managers_apart:drive"]
          lifetime: {LIFETIME}
          stop: {{message: {{speed: 0.0}}}}
  counter:
    components:
      - name: counter
        bridge: python
        output: {{endpoint: ["tests.server.test_managers_apart:counter"]}}
"""
ACCESS = """
version: 1
roles: {{fleet: {{see: all, request: all, send: all}}}}
tokens: [{{name: desk, role: fleet, sha256: {digest}}}]
"""
taken: list[float] = []
over = threading.Event()


class Speed(TypedDict):
    speed: float


class Value(TypedDict):
    value: int


def drive(command: Speed) -> None:
    taken.append(command["speed"])


def counter() -> Iterator[Value]:
    value = 0
    while not over.wait(0.005):
        value += 1
        yield {"value": value}


@pytest.fixture
def cable() -> Iterator[Cable]:
    taken.clear()
    over.clear()
    with laid_cable() as made:
        yield made
    over.set()


class Desk:
    """A desk at the far end of the cable."""

    def __init__(self, cable: Cable, *words: str) -> None:
        within = ["ip", "netns", "exec", cable.namespace, sys.executable, str(DESK)]
        self.process = subprocess.Popen(
            [*within, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.lines: list[str] = []
        self._reading = threading.Thread(target=self._read, daemon=True)
        self._reading.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as stream:
            self.lines += (line.strip() for line in stream)

    @property
    def last(self) -> str:
        return self.lines[-1] if self.lines else ""

    def say(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait(patience())
        if self.process.stdin is not None:
            self.process.stdin.close()
        self._reading.join(patience())


@contextmanager
def served(folder: Path, cable: Cable) -> Iterator[tuple[RobotManager, str, str]]:
    """Serve a robot at the near end; gives its address, and the file of the desk's token."""
    token, access = folder / "token", folder / "access.yaml"
    token.write_text(make_token(), encoding="ascii")
    access.write_text(ACCESS.format(digest=hash_token(token.read_text(encoding="ascii"))))
    options = ServerOptions(host=cable.here, port=0, access=access)
    with (
        RobotManager(loads(ROBOT)) as robot,
        serve_in_thread(robot, options) as server,
    ):
        yield robot, f"ws://{cable.here}:{server.ports[0]}/", str(token)


def test_across_a_cut_what_moves_stops_and_nothing_is_lost_uncounted(
    tmp_path: Path, cable: Cable
) -> None:
    cable.lose(2)
    with served(tmp_path, cable) as (robot, url, token):
        desk = Desk(cable, "import", url, token)
        try:
            wait(lambda: 0.5 in taken, "no command came")
            cut = time.monotonic()
            cable.cut()
            wait(lambda: taken[-1] == 0.0, "it was not stopped")
            wait(lambda: desk.last not in {"", "breaks 0"}, "the cut was not noticed")
            wait(lambda: time.monotonic() > cut + CUT)
            stopped = len(taken)
            cable.mend()
            wait(lambda: 0.5 in taken[stopped:], "commands do not pass again")
            desk.say("")
            wait(lambda: desk.last.startswith("lost"), "it did not say what was lost")
            _, missing, counted, gaps = desk.last.split()
            assert gaps == "0"  # the same session
            assert int(missing) > 0
            assert counted == missing
            desk.process.wait(patience())
            wait(lambda: not robot.status().connections, "a connection is stuck")
        finally:
            desk.kill()


def test_in_a_long_cut_a_local_candidate_takes_over_until_the_robot_is_back(
    tmp_path: Path, cable: Cable
) -> None:
    with served(tmp_path, cable) as (robot, url, token):
        desk = Desk(cable, "take-over", url, token)
        try:
            wait(lambda: 0.5 in taken, "no command came")
            wait(lambda: desk.last.startswith("far_base far_counter"), "it is not from afar")
            cut = time.monotonic()
            cable.cut()
            wait(lambda: taken[-1] == 0.0, "it was not stopped")
            stopped = len(taken)
            wait(lambda: desk.last == "near_base near_counter True", "nothing took over")
            wait(lambda: time.monotonic() > cut + CUT)
            assert len(taken) == stopped
            assert desk.last.startswith("near_base near_counter")
            cable.mend()
            wait(lambda: 0.5 in taken[stopped:], "commands do not pass again")
            wait(lambda: desk.last.startswith("far_base far_counter"), "it did not return")
            desk.say("")
            wait(lambda: desk.last == "gaps 2 2 0", "what was lost is not accounted for")
            desk.process.wait(patience())
            wait(lambda: not robot.status().connections, "a connection is stuck")
        finally:
            desk.kill()


def test_the_last_command_of_a_desk_that_is_killed_in_a_cut_never_arrives(
    tmp_path: Path, cable: Cable
) -> None:
    with served(tmp_path, cable) as (robot, url, token):
        desk = Desk(cable, "command", url, token)
        try:
            wait(lambda: desk.lines == ["open"], "it did not connect")
            cable.cut()
            desk.say("1.0")
            wait(lambda: desk.lines == ["open", "sent"], "it did not send")
            sent = time.monotonic()
            desk.kill()
            wait(lambda: time.monotonic() > sent + 1.5 * LIFETIME)
            cable.mend()
            wait(lambda: not robot.status().connections, "its end did not come")
            assert 1.0 not in taken
        finally:
            desk.kill()
