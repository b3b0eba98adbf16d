"""`scene.py --environments` makes what is missing, once, and the robot file names it."""

from __future__ import annotations

import json
import re
import string
import sys
from pathlib import Path

import pytest
import yaml
from tests.examples.healthbot import EXAMPLE

sys.path.insert(0, str(EXAMPLE))

from healthbot_scene import separate

from uoarm import environments

Made = list[tuple[str, tuple[str, ...]]]


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Made:
    """What is made; a folder with a mark is enough to be an environment."""
    monkeypatch.setenv("UOARM_HOME", str(tmp_path))
    names: Made = []

    def create(name: str, requirements: tuple[str, ...], *, progress: separate.Progress) -> None:
        progress("Collecting something")
        progress("chatter")
        names.append((name, requirements))
        folder = tmp_path / "environments" / name
        (folder / "bin").mkdir(parents=True)
        mark = {"name": name, "requirements": requirements}
        (folder / "uoarm-environment.json").write_text(json.dumps(mark))

    monkeypatch.setattr(environments, "create", create)
    return names


def test_what_is_missing_is_made_once_and_announced(made: Made) -> None:
    reports: list[str] = []
    separate.prepare_environments(reports.append)
    assert [name for name, _ in made] == ["healthbot-jazzy", "healthbot-rtm"]
    assert any("[jazzy]" in requirement for requirement in made[0][1])
    assert reports.count("  Collecting something") == 2
    assert not any("chatter" in line for line in reports)
    separate.prepare_environments(reports.append)
    assert len(made) == 2


def test_one_of_other_packages_is_made_anew(made: Made, tmp_path: Path) -> None:
    separate.prepare_environments(lambda _: None)
    mark = tmp_path / "environments" / "healthbot-rtm" / "uoarm-environment.json"
    mark.write_text(json.dumps({"name": "healthbot-rtm", "requirements": ["older"]}))
    separate.prepare_environments(lambda _: None)
    assert [name for name, _ in made[2:]] == ["healthbot-rtm"]


def test_the_robot_file_takes_either_kind_of_host() -> None:
    text = (EXAMPLE / "robot.yaml").read_text()
    names = set(re.findall(r"\$(\w+)", text))
    assert set(separate.HOSTS) <= names
    words = dict.fromkeys(names, "1")
    for word in ("true", "{environment: healthbot-jazzy}"):
        filled = words | dict.fromkeys(separate.HOSTS, word)
        robot = yaml.safe_load(string.Template(text).substitute(filled))
        assert robot["bridges"]["ros"]["host"] == robot["bridges"]["rtm"]["host"]
        assert robot["bridges"]["rtm"]["host"] == yaml.safe_load(word)
