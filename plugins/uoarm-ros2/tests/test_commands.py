"""`uoarm ros2`: nodes, types and structures, with exit statuses."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from typing import Any

import pytest
from endpoints import Start

from uoarm.cli import main
from uoarm.model import BridgeSpec, Options
from uoarm.testing import slowness, wait

Run = Callable[..., Any]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Runs a command; returns its status, its output (of --json as values), its errors.

    A graph counts as formed after a second: what is there is looked for again and again.
    """

    def spec(name: str, plugin: str, options: Options) -> BridgeSpec:
        return BridgeSpec(name, plugin, {"wait": slowness(), **options})

    def run_it(*words: str) -> tuple[int, Any, str]:
        try:
            main(["ros2", *words])
        except SystemExit as ended:
            status = int(ended.code or 0)
        printed = capsys.readouterr()
        is_json = "--json" in words and not status
        return status, json.loads(printed.out) if is_json else printed.out, printed.err

    monkeypatch.setattr("uoarm_ros2.__main__.BridgeSpec", spec)
    return run_it


def test_nodes_types_and_structures_are_shown(run: Run, peer: Start) -> None:
    peer("talker").do("advertise", topic="/numbers")
    numbers = {"role": "output", "name": "/numbers", "type": "std_msgs/msg/Int64", "known": True}

    def listed() -> bool:
        status, rows, _ = run("list", "--json")
        return status == 0 and {"node": "/talker", "endpoints": [numbers]} in rows

    wait(listed)
    wait(lambda: "  output  /numbers  std_msgs/msg/Int64" in run("list")[1].splitlines())
    known = {"type": "std_msgs/msg/Int64", "known": "installed", "nodes": ["/talker"]}
    wait(lambda: known in run("types", "--json")[1])

    def most() -> int:
        status, found, _ = run("echo-structure", "/numbers", "--json")
        return 0 if status else found["message"]["structure"]["properties"]["data"]["maximum"]

    wait(lambda: most() == 2**63 - 1)


def test_why_types_are_not_known_is_said_once_for_all_nodes_that_talk_them(
    run: Run, peer: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("left", "right"):
        peer(name).do("serve", name=f"/{name}/one")
        peer(f"{name}_too").do("act", name=f"/{name}/two")
    for name in [module for module in sys.modules if module.split(".")[0] == "test_msgs"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "test_msgs", None)

    def listed() -> list[str]:
        lines: list[str] = run("list")[1].splitlines()
        return lines if len(re.findall("structure unknown", "\n".join(lines))) == 4 else []

    looks: list[list[str]] = []

    def is_listed() -> bool:
        looks.append(listed())
        return bool(looks[-1])

    wait(is_listed)
    lines = looks[-1]
    assert "  service /left/one  test_msgs/srv/BasicTypes  (structure unknown)" in lines
    for kind in ("action", "srv"):
        assert sum(f"package 'test_msgs.{kind}' cannot" in line for line in lines) <= 1
    assert [line for line in lines if "the same" in line] == [
        "  the same as /left",
        "  the same as /left_too",
    ]


def test_what_is_installed_is_listed_without_a_graph(run: Run) -> None:
    status, names, _ = run("interfaces", "--json")
    assert status == 0
    assert {"std_msgs/msg/Int64", "std_srvs/srv/SetBool"} <= {*names}


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (("echo-structure", "/nowhere"), 4, "topic /nowhere is not on the graph"),
        (("echo-structure", "/x", "std_msgs/Int64"), 2, "did you mean 'std_msgs/msg/Int64'"),
        (("list", "--domain", "500"), 2, "argument --domain: expected 0 to 232, got 500"),
        (("list", "--domain", "-1"), 2, "argument --domain: expected 0 to 232, got -1"),
        (("list", "--domain", "x"), 2, "argument --domain: expected 0 to 232, got x"),
    ],
)
def test_what_cannot_be_shown_says_why(
    run: Run, words: tuple[str, ...], status: int, text: str
) -> None:
    got, _, report = run(*words)
    assert got == status
    assert text in report


def test_a_domain_of_the_environment_that_is_none_is_an_error_of_the_command(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ROS_DOMAIN_ID", "lab")
    status, _, report = run("list")
    first = "error: the environment says ROS_DOMAIN_ID='lab', expected 0 to 232"
    assert (status, report.splitlines()) == (4, [first, "uoarm explain UOA-403 says more"])
