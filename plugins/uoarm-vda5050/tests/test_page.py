"""The example runs as printed; and vehicles without a name are used."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

from brokers import Broker
from tests.processes import run_python  # type: ignore[import-not-found]
from uoarm_mqtt import BrokerOptions
from uoarm_vda5050._options import FleetOptions, VehicleOptions

from fleet import driven, goal
from uoarm import RobotManager
from uoarm.bridge import Registry, options_table
from uoarm.config import inspect
from uoarm.testing import patience, wait

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "vda5050.md"
EXAMPLE = ROOT / "examples" / "vda5050" / "README.md"


def test_the_example_runs_as_printed(broker: Broker, tmp_path: Path) -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    _, vehicle, robot, command, *_ = (
        found[1] for found in re.finditer(r"```\w+\n(.*?)```", text, re.DOTALL)
    )
    (tmp_path / "agv1.py").write_text(vehicle.replace("127.0.0.1", broker.host))
    (tmp_path / "robot.yaml").write_text(robot.replace("127.0.0.1", broker.host))
    driving = subprocess.Popen([sys.executable, "agv1.py"], cwd=tmp_path)
    # Half an order would leave the vehicle away from where the next one begins.
    words = ["-m", *shlex.split(command), "--timeout", str(patience())]
    said: list[str] = []

    def answered() -> bool:
        done = run_python(*words, cwd=tmp_path)
        said[:] = [done.stdout, done.stderr]
        return not done.returncode

    try:
        wait(answered, "the vehicle of the example did not come up")
        result = json.loads(said[0])
        assert result["lastNodeId"] == "shelf"
        assert [action["actionStatus"] for action in result["actions"]] == ["FINISHED"]
    finally:
        driving.kill()
        driving.wait()


def test_vehicles_that_are_not_configured_are_used(broker: Broker, tmp_path: Path) -> None:
    options = {"url": broker.url, "interface": "unnamed", "accept_timeout": patience()}
    bridges = {
        f"v{release[0]}": {"plugin": "vda5050", "options": {**options, "release": release}}
        for release in ("2.1", "3.0")
    }
    needs = {"role": "service", "port": "transport"}
    functions = {"transport": {"needs": needs}}
    file = tmp_path / "robot.yaml"
    file.write_text(json.dumps({"version": 1, "bridges": bridges, "functions": functions}))
    with (
        driven(broker, "stranger", release="3.0", interface="unnamed") as driver,
        RobotManager.from_file(file) as robot,
    ):
        robot.call("transport", goal("a", "b", b="pick"))
        wait(lambda: driver.done == ["b", "pick"])  # noted after the report


def test_the_tables_of_options_are_what_the_plugin_declares() -> None:
    page = PAGE.read_text(encoding="utf-8")
    every: Any = FleetOptions.schema()
    shared: Any = BrokerOptions.schema()
    names = every["properties"].keys() - shared["properties"].keys()
    own = {name: option for name, option in every["properties"].items() if name in names}
    assert options_table({"properties": own}) in page
    assert options_table(shared) in (ROOT / "docs" / "mqtt.md").read_text(encoding="utf-8")
    assert options_table(VehicleOptions.schema(), "option of a port") in page


def test_a_wrong_option_is_reported_with_its_place_and_the_one_that_is_meant(
    tmp_path: Path,
) -> None:
    page = EXAMPLE.read_text(encoding="utf-8")
    (text,) = re.findall(r"```yaml\n(version: 1.*?)```", page, re.DOTALL)
    file = tmp_path / "robot.yaml"
    written = text.replace("agv1, state]}", "agv1, state], options: {hedder: true}}")
    file.write_text(written.replace('release: "2.1"', 'release: "2.1", repaet: 1'))
    reports = [str(problem) for problem in inspect(file, types=Registry().types).problems]
    assert any("hedder" in report and 'did you mean "header"' in report for report in reports)
    assert any("repaet" in report and 'did you mean "repeat"' in report for report in reports)
    place = re.compile(r"robot\.yaml:\d+:\d+")
    assert all(place.search(report) for report in reports), reports
