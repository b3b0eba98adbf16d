"""A robot with an input that one sender at a time may command, and the clients who may."""

from __future__ import annotations

from uoarm import RobotManager
from uoarm.bridge import Registry
from uoarm.config import loads
from uoarm.model import LeaseStatus
from uoarm.server import make_token
from uoarm.testing import MemoryBridge

ACCESS = """
version: 1
roles:
  driver: {{see: all, request: ["*"], send: ["*"]}}
  safety: {{see: all, request: ["*"], send: ["*"]}}
tokens:
  - {{name: driver, role: driver, sha256: {driver}}}
  - {{name: safety, role: safety, sha256: {safety}}}
"""
TOKENS = {"driver": make_token(), "safety": make_token()}


def leased_robot(memory: MemoryBridge, *, stop: str = "0", more: str = "") -> RobotManager:
    """Make a robot of which `drive` moves `base`; a safety takes it from a driver.

    Args:
        memory: has what the robot moves.
        stop: message that stops it, as YAML.
        more: further functions, as YAML below `functions`.
    """
    text = f"""
version: 1
bridges: {{memory: {{plugin: python}}}}
functions:
  drive:
    components:
      - name: base
        bridge: memory
        input:
          endpoint: [base]
          lifetime: 3600
          stop: {{message: {stop}}}
          lease: {{duration: 3600, priorities: {{safety: 10}}}}
  {more}
"""
    return RobotManager(loads(text), registry=Registry(()), bridges={"memory": memory})


def lease(robot: RobotManager) -> LeaseStatus:
    """Return who holds the lease of the one component that is open."""
    (component,) = robot.status().components
    found = component.channels[0].lease
    assert found is not None
    return found
