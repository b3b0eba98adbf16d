"""`uoarm list`, `resolve`, `request` and `call` with --url: the robot that runs there is asked."""

from __future__ import annotations

import json
import os
from collections.abc import Callable

import pytest
from click.testing import CliRunner, Result
from tests.server.conftest import Serve
from tests.server.robot import END, script

from uoarm import RobotManager
from uoarm.cli import _run, main
from uoarm.testing import Background, patience, wait

Ask = Callable[..., Result]


@pytest.fixture
def ask(serve: Serve) -> Ask:
    """Run a command against the served robot."""
    url = f"ws://127.0.0.1:{serve().ports[0]}/"

    def run(*words: str) -> Result:
        return CliRunner().invoke(main, [*words, "--url", url])

    return run


def test_what_is_served_is_listed(ask: Ask) -> None:
    lines = ask("list").stdout.splitlines()
    assert lines[:2] == ["numbers  what a test plays", "     0  numbers  (python)"]
    (first, *_) = json.loads(ask("list", "--json").stdout)
    assert first["name"] == "numbers"
    assert first["components"][0]["bridge"] == "python"


def test_the_plan_is_that_of_the_robot(ask: Ask) -> None:
    assert ask("resolve", "doubled").stdout == "numbers -> doubled\n"
    assert "1. numbers: numbers (python" in ask("resolve", "doubled", "--explain").stdout
    plan = json.loads(ask("resolve", "doubled", "--json").stdout)
    assert [step["component"]["name"] for step in plan["steps"]] == ["numbers", "doubled"]
    refused = ask("resolve", "nothing")
    assert refused.exit_code == 1
    assert "there is no function 'nothing'" in refused.stderr


def test_a_component_that_runs_is_shared(ask: Ask, robot: RobotManager) -> None:
    with robot.request("numbers") as own:
        asked = Background(lambda: ask("request", "numbers", "-n", "2"))
        wait(lambda: len(robot.status().routes) == 2)  # it receives from then on
        script.put({"value": 1}, {"value": 2})
        result = asked.result()
        assert [own.get(patience()), own.get(patience())] == [{"value": 1}, {"value": 2}]
        assert [component.name for component in robot.status().components] == ["numbers"]
    assert result.stdout == '{"value": 1}\n{"value": 2}\n'
    assert result.exit_code == 0
    wait(lambda: not robot.status().routes)


def test_it_ends_when_its_source_has_finished(ask: Ask) -> None:
    script.put({"value": 1}, END)
    result = ask("request", "doubled")
    assert (result.stdout, result.exit_code) == ('{"value": 2}\n', 0)


def test_it_ends_after_the_seconds_it_is_given(ask: Ask) -> None:
    result = ask("request", "numbers", "--duration", "0.1")
    assert (result.stdout, result.exit_code) == ("", 0)


def test_what_keeps_messages_from_coming_is_a_warning(
    ask: Ask, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("uoarm.client._client._DIAGNOSIS_SECONDS", patience())
    warnings: list[str] = []
    monkeypatch.setattr(_run, "print_warning", warnings.append)
    asking = Background(lambda: ask("request", "doubled"))
    script.put({"value": 1}, {"value": object()})
    start = "numbers is degraded: its output 'default' gave what does not match"
    wait(lambda: any(warning.startswith(start) for warning in warnings))
    script.put({"value": 3}, END)
    assert asking.result().stdout == '{"value": 2}\n{"value": 6}\n'
    assert len(set(warnings)) == len(warnings)


def test_a_failure_is_named_with_exit_code_4(ask: Ask) -> None:
    script.put({"value": 1}, ValueError("the lens is dirty"))
    result = ask("request", "numbers")
    assert result.exit_code == 4
    assert "its source raised ValueError: the lens is dirty" in result.stderr


def test_a_service_is_called(ask: Ask) -> None:
    assert ask("call", "add", '{"a": 1, "b": 2}').stdout == '{"value": 3}\n'
    refused = ask("call", "add", '{"a": "x"}')
    assert refused.exit_code == 1
    assert "request to 'add'" in refused.stderr or "add" in refused.stderr


def test_a_service_is_not_requested(ask: Ask) -> None:
    result = ask("request", "add")
    assert "function 'add' is a service: use call, not request" in result.stderr


def test_who_names_no_function_is_given_the_command_that_lists_them(ask: Ask) -> None:
    assert "uoarm list --url ws://127.0.0.1:" in ask("request").stderr


def test_a_terminal_is_shown_lines_that_fit_it(ask: Ask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    ours, theirs = os.openpty()
    with os.fdopen(theirs, "w") as terminal:
        monkeypatch.setattr("uoarm.cli._run.output", lambda: terminal)
        script.pictures.put({"width": 1, "data": b"\0" * 10_000}, END)
        assert ask("request", "picture").exit_code == 0
    shown = os.read(ours, 4096).decode()
    os.close(ours)
    assert shown.startswith('{"width": 1')
    assert len(shown.splitlines()) == 1
    assert len(shown.strip()) <= 40
