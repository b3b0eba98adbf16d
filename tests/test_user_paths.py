"""`~` in paths, and where programs of a user keep things, also of a user without a home."""

from __future__ import annotations

import os
import pwd
from pathlib import Path
from typing import NoReturn

import pytest
from click.testing import CliRunner
from tests.test_layers import ROOT

from uoarm._support.files import expanded, user_folder
from uoarm.cli import main
from uoarm.errors import UsageError

UNKNOWN = "~no_user_of_this_name"


@pytest.fixture
def homeless(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have the user no home, as one that a container chose by its number."""

    def unknown(number: int) -> NoReturn:
        raise KeyError(number)

    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setattr(pwd, "getpwuid", unknown)


def test_a_home_is_put_in_the_place_of_its_sign_where_it_is_known(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    assert expanded("~/robot") == tmp_path / "robot"
    assert expanded("robot/~") == Path("robot/~")
    assert str(expanded(f"{UNKNOWN}/robot")) == f"{UNKNOWN}/robot"


@pytest.mark.parametrize(
    ("kind", "place"), [("cache", ".cache"), ("data", ".local/share"), ("state", ".local/state")]
)
def test_folders_are_those_of_the_specification(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, kind: str, place: str
) -> None:
    variable = f"XDG_{kind.upper()}_HOME"
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.delenv(variable, raising=False)
    assert user_folder(kind) == tmp_path / place / "uoarm"
    monkeypatch.setenv(variable, str(tmp_path / "named"))
    assert user_folder(kind) == tmp_path / "named" / "uoarm"


@pytest.mark.usefixtures("homeless")
@pytest.mark.parametrize("words", [["env", "list"], ["serve"], ["up"]], ids=" ".join)
def test_a_user_without_a_home_learns_which_variable_to_set(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, words: list[str]
) -> None:
    for variable in ("XDG_STATE_HOME", "XDG_DATA_HOME", "UOARM_HOME"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "robot.yaml").write_text("version: 1\nbridges: {python: {}}\nfunctions: {}\n")
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 1, done.output
    kind = "DATA" if words[0] == "env" else "STATE"
    assert f"this user has no home: set XDG_{kind}_HOME to a folder" in done.stderr


@pytest.mark.usefixtures("homeless")
def test_without_a_home_a_named_folder_is_used(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert user_folder("state") == tmp_path / "uoarm"
    monkeypatch.delenv("XDG_STATE_HOME")
    with pytest.raises(UsageError, match="XDG_STATE_HOME"):
        user_folder("state")


def test_a_path_in_the_home_of_no_user_is_named_as_it_was_written(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    python = f"{UNKNOWN}/bin/python"
    (tmp_path / "robot.yaml").write_text(
        f"version: 1\nbridges: {{python: {{host: {{python: {python}}}}}}}\nfunctions: {{}}\n"
    )
    done = CliRunner().invoke(main, ["check"])
    assert not done.exception or isinstance(done.exception, SystemExit)
    assert python in done.output
    joined = ["host", "--join", "tls/127.0.0.1:1", "--machine", "m", "--certificates", UNKNOWN]
    assert f"there is no {UNKNOWN}{os.sep}ca.pem" in CliRunner().invoke(main, joined).stderr


def test_no_module_uses_the_function_that_raises_what_is_no_error_of_a_path() -> None:
    plugins = ROOT.parents[1] / "plugins"
    modules = [*ROOT.rglob("*.py"), *plugins.glob("*/src/**/*.py")]
    found = [str(module) for module in modules if ".expanduser()" in module.read_text("utf-8")]
    assert not found, "use `expanded`"
