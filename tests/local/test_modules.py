"""Modules of a bridge's folders: each bridge runs its own, and Python's ways with modules work."""

from __future__ import annotations

import importlib
import pickle
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.errors import BridgeError, FailureReason
from uoarm.local import PythonBridge, PythonOptions
from uoarm.model import Endpoint, Role
from uoarm.testing import patience

WHO = """
from typing import TypedDict

class Name(TypedDict):
    name: str

def who(asked: Name) -> Name:
    from their_words import WORD
    return {{"name": "{0} " + WORD}}
"""

ROBOT = """
version: 1
bridges:
  first: {plugin: python, options: {path: [FIRST]}}
  second: {plugin: python, options: {path: [SECOND]}}
functions:
  one: {components: [{name: a, bridge: first, service: {endpoint: ["their_service:who"]}}]}
  two: {components: [{name: b, bridge: second, service: {endpoint: ["their_service:who"]}}]}
"""


def folder(place: Path, name: str, **files: str) -> Path:
    made = place / name
    for file, text in files.items():
        path = made / file.replace("__in__", "/")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.with_suffix(".py").write_text(text, encoding="utf-8")
    return made


@pytest.fixture
def two(tmp_path: Path) -> Iterator[tuple[Path, Path]]:
    """Two folders with modules of the same names, which the program forgets again."""
    yield tuple(  # type: ignore[misc] # two of them
        folder(
            tmp_path,
            name,
            their_service=WHO.format(name),
            their_words=f"WORD = 'says {name}'",
        )
        for name in ("first", "second")
    )
    for name in ("their_words", "their_service"):
        sys.modules.pop(name, None)


def call(place: Path, address: str, message: Any, *more: Path) -> Any:
    bridge = PythonBridge("p", PythonOptions.of({"path": [str(path) for path in (place, *more)]}))
    try:
        return bridge.call(service(address), message, timeout=patience())
    finally:
        bridge.close()


def service(address: str) -> Endpoint:
    return Endpoint("p", "c", Role.SERVICE, (address,))


def test_each_of_two_bridges_runs_its_own_module(two: tuple[Path, Path]) -> None:
    text = ROBOT.replace("FIRST", str(two[0])).replace("SECOND", str(two[1]))
    with RobotManager(loads(text)) as robot:
        assert robot.call("one", {"name": ""}) == {"name": "first says first"}
        assert robot.call("two", {"name": ""}) == {"name": "second says second"}


def test_each_of_two_managers_runs_its_own_module(two: tuple[Path, Path]) -> None:
    for place in two:
        text = ROBOT.replace("FIRST", str(place)).replace("SECOND", str(place))
        with RobotManager(loads(text)) as robot:
            name = place.name
            assert robot.call("one", {"name": ""}) == {"name": f"{name} says {name}"}


def test_the_program_keeps_its_own_module_and_its_path(
    two: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = list(sys.path)
    assert call(two[0], "their_service:who", {"name": ""}) == {"name": "first says first"}
    assert sys.path == before
    assert not {"their_words", "their_service"} & sys.modules.keys()


def test_a_module_of_the_program_does_not_stand_in_for_that_of_a_folder(
    two: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(two[0])
    importlib.import_module("their_words")
    assert call(two[1], "their_service:who", {"name": ""}) == {"name": "second says second"}


def test_a_folder_further_back_on_the_path_of_the_program_runs_its_own_module(
    two: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(two[1])
    monkeypatch.syspath_prepend(two[0])
    assert call(two[1], "their_service:who", {"name": ""}) == {"name": "second says second"}
    assert "their_words" not in sys.modules


def test_a_module_that_the_program_could_import_is_the_same_for_both(
    two: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(two[0])
    their_words = importlib.import_module("their_words")

    monkeypatch.setattr(their_words, "WORD", "is changed")
    assert call(two[0], "their_service:who", {"name": ""}) == {"name": "first is changed"}


KINDS = """
from __future__ import annotations

import pickle
from dataclasses import dataclass, field, fields
from typing import ClassVar, get_type_hints

import kinds_other
import kinds_package.inner
import kinds_package.inner as known
from kinds_package import inner, outer

__all__ = ["Point"]


@dataclass
class Point:
    x: int
    many: ClassVar[int] = 0


def square(point: Point) -> Point:
    return Point(point.x ** 2)


def facts(asked):
    kind = asked["kind"]
    if kind == "pickle":
        return pickle.loads(pickle.dumps(Point(3))) == Point(3)
    if kind == "pickled":
        return pickle.dumps((square, Point(3)))
    if kind == "dataclass":
        hint = get_type_hints(square)["point"]
        return [one.name for one in fields(Point)] == ["x"] and hint is Point
    if kind == "imports":
        return [
            inner is known is kinds_package.inner, inner.other is kinds_other, outer.inner is inner,
            kinds_other.Point is Point,
        ]
    raise LookupError(kind)
"""


@pytest.fixture
def kinds(tmp_path: Path) -> Callable[[str], Any]:
    place = folder(
        tmp_path,
        "kinds",
        python_kinds=KINDS,
        kinds_other="import python_kinds as it\ndef __getattr__(name): return getattr(it, name)",
        kinds_package__in____init__="",
        kinds_package__in__inner="import kinds_other as other",
        kinds_package__in__outer="from . import inner\nfrom .inner import other",
    )
    return lambda kind: call(place, "python_kinds:facts", {"kind": kind})


@pytest.mark.parametrize("kind", ["pickle", "dataclass"])
def test_what_looks_a_module_up_by_name_finds_it(kinds: Callable[[str], Any], kind: str) -> None:
    assert kinds(kind) is True


def test_imports_in_a_folder_reach_its_modules_and_packages(kinds: Callable[[str], Any]) -> None:
    assert kinds("imports") == [True] * 4


def test_another_process_finds_the_module(kinds: Callable[[str], Any]) -> None:
    """As those that multiprocessing spawns do."""
    code = "import pickle, sys; do, point = pickle.load(sys.stdin.buffer); print(do(point).x)"
    done = subprocess.run(
        [sys.executable, "-c", code],
        input=kinds("pickled"),
        capture_output=True,
        check=True,
        timeout=patience(),
    )
    assert done.stdout.strip() == b"9"


def test_a_traceback_shows_the_line_of_the_file(kinds: Callable[[str], Any]) -> None:
    with pytest.raises(BridgeError) as caught:
        kinds("no such kind")
    text = "".join(traceback.format_exception(caught.value))
    assert "python_kinds.py" in text
    assert "raise LookupError(kind)" in text


def test_what_is_installed_is_imported_once(tmp_path: Path) -> None:
    import attrs

    place = folder(
        tmp_path, "own", uses_attrs="import attrs, queue\ndef known(_): return attrs, queue"
    )
    known = call(place, "uses_attrs:known", None, Path(attrs.__file__).parents[1])
    assert known[0] is attrs
    import queue

    assert known[1] is queue


def test_a_module_named_like_one_of_python_is_for_its_folder_alone(tmp_path: Path) -> None:
    place = folder(
        tmp_path,
        "shadow",
        uses_queue="import queue\ndef known(_): return queue.MINE",
        queue="MINE = 'mine'",
    )
    assert call(place, "uses_queue:known", None) == "mine"
    import queue

    assert not hasattr(queue, "MINE")


def test_a_missing_module_is_named_as_it_was_written(tmp_path: Path) -> None:
    place = folder(
        tmp_path,
        "lacking",
        lacks_part="import lacking_package.nothing",
        lacking_package__in____init__="",
    )
    with pytest.raises(BridgeError, match=r"'lacks_part'.*'lacking_package.nothing'") as caught:
        call(place, "lacks_part:x", None)
    assert "uoarm.local" not in str(caught.value)
    with pytest.raises(BridgeError, match=r"no module 'lacks_par'") as caught:
        call(place, "lacks_par:x", None)
    assert caught.value.reason is FailureReason.NOT_FOUND


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ("from typing import Any\n\nwho = Ani", r"NameError: .*'Ani' .* \(fails.py, line 3\)$"),
        ("import other", r"ZeroDivisionError: .* \(other.py, line 2\)$"),
        ("who = (", r"SyntaxError: .* \(fails.py, line 1\)$"),
        (
            "from other_names import x",
            r"name 'x' from 'other_names' .*\(fails.py, line 1\)",
        ),
    ],
)
def test_what_fails_as_a_module_is_imported_is_reported_with_its_line(
    tmp_path: Path, code: str, expected: str
) -> None:
    place = folder(tmp_path, "failing", fails=code, other="\nwho = 1 / 0", other_names="")
    with pytest.raises(BridgeError, match=expected) as caught:
        call(place, "fails:who", None)
    assert "uoarm.local" not in str(caught.value)


def test_an_object_of_a_folder_can_be_pickled_by_the_program(tmp_path: Path) -> None:
    place = folder(
        tmp_path,
        "pickled",
        gives_box="class Box:\n    value = 1\ndef box(_):\n    return Box()",
    )
    box = call(place, "gives_box:box", None)
    assert type(pickle.loads(pickle.dumps(box))) is type(box)
