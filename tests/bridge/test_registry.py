"""The registry loads a plugin when one of its types is asked for."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from uoarm.bridge import Registry
from uoarm.errors import PluginError
from uoarm.testing import patience

PLUGIN = """
from uoarm.bridge import BridgeType, hookimpl

@hookimpl
def uoarm_bridge_types():
    return [BridgeType(name=name, summary="", create=print, contract=2) for name in {names}]
"""


@pytest.fixture
def points(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[EntryPoint]]:
    """Return plugins: `early` and `late` with a type each, `both` with two, `broken` with none."""
    monkeypatch.syspath_prepend(tmp_path)
    names = {"early": ["early"], "late": ["late"], "both": ["more", "late"]}
    for name, kinds in names.items():
        (tmp_path / f"lazy_{name}.py").write_text(PLUGIN.format(names=kinds), encoding="utf-8")
    (tmp_path / "lazy_broken.py").write_text("raise RuntimeError('no')", encoding="utf-8")
    found = [
        EntryPoint(name, f"lazy_{name}", "uoarm.bridges")
        for name in ("late", "early", "broken", "both")
    ]
    yield found
    for point in found:
        sys.modules.pop(point.module, None)


def loaded(points: list[EntryPoint]) -> set[str]:
    return {point.name for point in points if point.module in sys.modules}


def test_a_plugin_is_loaded_when_its_type_is_asked_for(points: list[EntryPoint]) -> None:
    registry = Registry(points)
    assert loaded(points) == set()
    assert registry.types["early"].name == "early"
    assert "early" in registry.types
    assert loaded(points) == {"early"}


def test_a_type_of_another_name_than_its_plugin_is_found(points: list[EntryPoint]) -> None:
    assert Registry(points).types["more"].name == "more"


def test_entry_points_need_not_be_comparable(points: list[EntryPoint]) -> None:
    """On CPython 3.10, those of importlib_metadata and those of the library's own are not."""

    class Foreign(EntryPoint):
        __hash__ = EntryPoint.__hash__

        def __eq__(self, other: object) -> bool:
            raise AttributeError("_key")

    registry = Registry([Foreign(point.name, point.value, point.group) for point in points])
    assert registry.types["more"].name == "more"


@pytest.mark.parametrize("asked", ["early", "late", "more", "nothing"])
def test_what_is_asked_first_changes_no_answer(asked: str, points: list[EntryPoint]) -> None:
    registry = Registry(points)
    registry.types.get(asked)
    assert [*registry.types] == ["early", "late", "more"]
    assert len(registry.types) == 3
    assert [problem.name for problem in registry.problems] == ["both", "broken"]
    assert "already provided by another plugin" in registry.problems[0].cause
    assert "nothing" not in registry.types


def test_an_added_type_may_not_have_the_name_of_a_plugin(points: list[EntryPoint]) -> None:
    registry = Registry(points)
    with pytest.raises(PluginError, match="'late' is already provided by another plugin"):
        registry.add(Registry(points).types["late"])


def test_threads_that_ask_at_once_get_one_type(points: list[EntryPoint]) -> None:
    registry = Registry(points)
    barrier, found = threading.Barrier(4, timeout=patience()), []

    def ask() -> None:
        barrier.wait()
        found.append(registry.types["early"])

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(patience())
    assert len({id(kind) for kind in found}) == 1
    assert len(found) == 4
