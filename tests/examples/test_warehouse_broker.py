"""The warehouse's broker ends with the scene, even if that is killed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

from tests.processes import lives

from uoarm.testing import patience, wait

EXAMPLES = Path(__file__).parents[2] / "examples"
FOLDERS = [EXAMPLES / "warehouse", EXAMPLES / "healthbot", EXAMPLES / "vision"]
SCENE = """
import sys, time
from pathlib import Path
from healthbot_scene.crew import Crew
from warehouse_scene.parts import make_places, parts_of

places = make_places(Path(sys.argv[1]))
parts = {part.name: part for part in parts_of(places, Path("robot.yaml"))}
with Crew(places.run, places.environment()) as crew:
    print(crew.start(parts["broker"]).process.pid, flush=True)
    time.sleep(3600)
"""


def test_the_broker_ends_with_a_scene_that_is_killed(tmp_path: Path) -> None:
    command = [sys.executable, "-c", SCENE, str(tmp_path)]
    # USER is what a container or sudo left there, and no user whom the system knows.
    variables = {"PYTHONPATH": os.pathsep.join(map(str, FOLDERS)), "USER": "stranger-here"}
    environment = {**os.environ, **variables, "LOGNAME": "stranger-here"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=environment, text=True) as scene:
        assert scene.stdout is not None
        pid = int(scene.stdout.readline())
        scene.send_signal(signal.SIGKILL)
    wait(lambda: not lives(pid), timeout=patience())
