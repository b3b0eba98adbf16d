"""Every rule of the kit is broken once in the bridge that `uoarm new-bridge` makes, and sees it."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from tests.testing.bad_worlds import LINKS, Bug
from tests.testing.kit_bugs import GENERAL, hold_found_out, rules_without_a_bug

import uoarm.cli
from uoarm.bridge import Registry
from uoarm.testing.conformance._failures import Breaking

TEMPLATE = Path(uoarm.cli.__file__).parent / "template"


def _deaf_after(world: Any, bridge: Any) -> None:
    connection = bridge._connection
    up = connection._up

    def up_alone() -> None:
        members, connection._members = connection._members, {}
        up()
        connection._members = members

    connection._up = up_alone


OWN = (
    Bug(
        LINKS,
        "subscribes to nothing again after a break",
        _deaf_after,
        Breaking.test_messages_pass_again_once_it_is_mended_each_once,
        "was not reported to be well again",
    ),
)


@pytest.fixture(scope="module")
def suite() -> Iterator[Any]:
    """The tests of the template, as a module."""
    folders = [str(TEMPLATE / "src"), str(TEMPLATE / "tests")]
    sys.path[:0] = folders
    try:
        yield importlib.import_module("test_conformance")
    finally:
        del sys.path[: len(folders)]
        for name in ("test_conformance", "bus"):
            del sys.modules[name]


@pytest.mark.long
@pytest.mark.parametrize("bug", [*GENERAL, *OWN], ids=lambda bug: bug.name.replace(" ", "-"))
def test_the_kit_sees_each_bug_in_what_is_generated(bug: Bug, suite: Any) -> None:
    plugin = importlib.import_module("uoarm_example")

    class World(suite.ExampleWorld):  # type: ignore[misc]
        def registry(self) -> Registry:
            made = Registry([])
            made.add(plugin.uoarm_bridge_types()[0])
            return made

    @contextmanager
    def opened() -> Iterator[Any]:
        world = World()
        try:
            yield world
        finally:
            world.close()

    kind = "text" if bug.pair == "text" else "temperature"
    hold_found_out(bug, opened, suite.TestExampleBridge(), kind)


def test_each_rule_has_a_bug() -> None:
    assert rules_without_a_bug((*GENERAL, *OWN)) == set()
