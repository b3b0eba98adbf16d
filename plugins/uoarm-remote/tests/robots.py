"""Robots that are served on loopback, and desks that import their functions."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest

from uoarm import RobotManager
from uoarm.cli import main
from uoarm.config import loads
from uoarm.model import Robot
from uoarm.server import Server, ServerOptions, serve_in_thread

ROBOT = """
version: 1
bridges: {python: {}}
failover: {enabled: false}
export: {local: ["*"]}
functions:
  integers:
    components:
      - name: integers
        bridge: python
        input: {endpoint: ["parts:integers"], queue: {length: 10000}}
        output: {endpoint: ["parts:integers"]}
  text:
    components:
      - name: text
        bridge: python
        input: {endpoint: ["parts:text"], queue: {length: 10000}}
        output: {endpoint: ["parts:text"]}
  pose:
    components:
      - name: pose
        bridge: python
        input: {endpoint: ["parts:pose"], queue: {length: 10000}}
        output: {endpoint: ["parts:pose"]}
  image:
    components:
      - name: image
        bridge: python
        input: {endpoint: ["parts:image"], queue: {length: 100}}
        output: {endpoint: ["parts:image"]}
  first: {components: [{name: first, bridge: python, output: {endpoint: ["parts:first"]}}]}
  second: {components: [{name: second, bridge: python, output: {endpoint: ["parts:second"]}}]}
  counter: {components: [{name: counter, bridge: python, output: {endpoint: ["parts:counter"]}}]}
  double: {components: [{name: double, bridge: python, service: {endpoint: ["parts:double"]}}]}
  length: {components: [{name: length, bridge: python, service: {endpoint: ["parts:length"]}}]}
  failing: {components: [{name: failing, bridge: python, service: {endpoint: ["parts:failing"]}}]}
  silent: {components: [{name: silent, bridge: python, service: {endpoint: ["parts:silent"]}}]}
  drive:
    components:
      - name: base
        bridge: python
        input: {endpoint: ["parts:drive"], lifetime: 2.0, stop: {message: {speed: 0.0}}}
"""


def here(name: str = "robot.yaml") -> str:
    """Return the file that a configuration of a test stands for."""
    return str(Path(__file__).parent / name)


class ServedRobot:
    """A robot before which a server can be ended, and be there again on the same port."""

    def __init__(
        self, robot: str | Robot = ROBOT, access: Path | None = None, port: int = 0
    ) -> None:
        self.manager = RobotManager(
            loads(robot, origin=here()) if isinstance(robot, str) else robot
        )
        self._access = access
        self._serving = ExitStack()
        self.port = port
        self.server: Server | None = None
        self.start()

    @property
    def url(self) -> str:
        """Where it is served."""
        return f"ws://127.0.0.1:{self.port}/"

    def start(self) -> None:
        """Serve it, on the port that it had."""
        options = ServerOptions(port=self.port, access=self._access)
        self.server = self._serving.enter_context(serve_in_thread(self.manager, options))
        self.port = self.server.ports[0]

    def stop(self) -> None:
        """Serve it no more."""
        self._serving.close()

    def close(self) -> None:
        """End it."""
        self.stop()
        self.manager.close()


def fleet(*words: str) -> int:
    """Run `uoarm fleet`; return its exit code."""
    with pytest.raises(SystemExit) as ended:
        main(["fleet", *words])
    return int(ended.value.code or 0)
