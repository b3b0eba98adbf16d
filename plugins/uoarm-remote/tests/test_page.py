"""The page is true: its tables are those of the options, and its two managers run as written."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from robots import ServedRobot
from uoarm_remote._options import FunctionOptions, ManagerOptions

from uoarm import RobotManager
from uoarm.bridge import EndpointOptions, options_table
from uoarm.config import load, loads
from uoarm.testing import patience

PAGE = (Path(__file__).parents[3] / "docs" / "fleet.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", [FunctionOptions, ManagerOptions])
def test_the_tables_of_options_are_those_of_the_page(kind: type[EndpointOptions]) -> None:
    assert options_table(kind.schema()) in PAGE
    schema: Any = kind.schema()
    properties = schema["properties"]
    assert not [
        name
        for name, option in properties.items()
        if option.get("x-unit") == "s" and "seconds" not in option["description"]
    ]


def test_the_two_managers_of_the_page_run(tmp_path: Path) -> None:
    (parts,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    robot, desk, *_ = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "parts.py").write_text(parts, encoding="utf-8")
    (tmp_path / "robot.yaml").write_text(robot, encoding="utf-8")
    served = ServedRobot(load(tmp_path / "robot.yaml"))
    try:
        text = desk.replace("ws://127.0.0.1:9080/", served.url)
        with RobotManager(loads(text)) as manager, manager.request("pose") as poses:
            assert [poses.get(patience())["x"] for _ in range(2)] == [0.0, 1.0]
    finally:
        served.close()
