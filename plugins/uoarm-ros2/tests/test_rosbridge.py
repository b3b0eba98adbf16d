"""A ROS 2 action behind the rosbridge endpoint, with an unmodified client."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from peers import DOMAIN, Peer

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import Settings, serve_in_thread

CLIENT = Path(__file__).with_name("action_client.py")
ADDRESS = "/fibonacci, test_msgs/action/Fibonacci"
CONFIGURATION = f"""
version: 1
bridges:
  ros: {{plugin: ros2, options: {{domain_id: {DOMAIN}}}}}
functions:
  fibonacci:
    components:
      - name: fibonacci
        bridge: ros
        inputs:
          goal: {{endpoint: [{ADDRESS}]}}
          cancel: {{endpoint: [{ADDRESS}]}}
        outputs:
          status: {{endpoint: [{ADDRESS}]}}
          feedback: {{endpoint: [{ADDRESS}]}}
          result: {{endpoint: [{ADDRESS}]}}
"""


def test_roslibpy_sends_goals_to_an_action(peer: Callable[..., Peer]) -> None:
    peer("doer", "threads").do("act", name="/fibonacci")
    robot = loads(CONFIGURATION, origin=str(Path(__file__).with_name("robot.yaml")))
    with (
        RobotManager(robot) as manager,
        serve_in_thread(manager, Settings(port=0)) as server,
    ):
        url = f"ws://127.0.0.1:{server.ports[0]}/rosbridge"
        done = subprocess.run(
            [sys.executable, str(CLIENT), url],
            capture_output=True,
            text=True,
            check=False,
        )
    assert done.stdout == "done\n", done.stdout + done.stderr
