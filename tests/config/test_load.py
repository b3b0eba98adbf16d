"""Configurations: every mistake at once, each with its place; hostile files end."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from uoarm.config import inspect, load, loads
from uoarm.errors import ConfigurationError
from uoarm.model import OverflowPolicy, PortRef

GOOD = """\
version: 1
bridges:
  python: {}
  ros: {plugin: ros2, options: {domain_id: 7}}
functions:
  camera:
    components:
      - {name: eye, bridge: ros, priority: 20, output: {endpoint: [/image, Image]}}
      - {name: recorded, bridge: python, priority: 30, output: {endpoint: ["m:camera"]}}
  faces:
    components:
      - name: finder
        bridge: python
        parameters: {size: 3}
        input:
          from: camera
          endpoint: ["m:find"]
          map: {pixels: data}
          allow_loss: [header]
          queue: {length: 1, policy: latest}
        outputs: {faces: {endpoint: ["m:find"]}, debug: {endpoint: ["m:find"]}}
"""


def test_a_good_file_becomes_a_robot() -> None:
    robot = loads(GOOD)
    assert [one.name for one in robot.functions["camera"].components] == ["recorded", "eye"]
    (finder,) = robot.functions["faces"].components
    (port,) = finder.inputs
    assert port.source == PortRef("camera")
    assert port.mapping == {"pixels": "data"}
    assert port.allow_loss == ("header",)
    assert port.queue is not None
    assert port.queue.policy is OverflowPolicy.LATEST
    assert finder.output("debug") is not None
    assert port.endpoint.parameters == {"size": 3}


def change(old: str, new: str) -> str:
    assert old in GOOD
    return GOOD.replace(old, new)


BAD = {
    "a tab": (change("  python: {}", "\tpython: {}"), 3, "tabs"),
    "a key twice": (
        change("  ros: {plugin", "  python: {plugin"),
        4,
        "given twice; first in line 3",
    ),
    "an unknown key": (change("priority: 20", "priorty: 20"), 8, "did you mean 'priority'?"),
    "a wrong type": (change("priority: 20", "priority: high"), 8, 'a whole number, got "high"'),
    "an unknown bridge": (change("bridge: ros", "bridge: rose"), 8, "did you mean 'ros'?"),
    "an unknown function": (change("from: camera", "from: camara"), 16, "did you mean 'camera'?"),
    "an unknown output": (change("from: camera", "from: camera.depth"), 16, "no output 'depth'"),
    "a name twice": (change("name: recorded", "name: eye"), 9, "used twice, first in line 8"),
    "another version": (change("version: 1", "version: 2"), 1, "expected 1, got 2"),
    "a missing key": (change("name: finder", "priority: 1"), 12, "'name' is missing"),
    "a bad policy": (change("policy: latest", "policy: newest"), 20, "latest, drop-oldest, block"),
    "input twice": (
        change("outputs:", "inputs: {a: {endpoint: [x]}}\n        outputs:"),
        16,
        "not both",
    ),
    "a tag": (change("python: {}", "python: !!python/none {}"), 3, "tag"),
    "a number as key": (change("  python: {}", "  7: {}"), 3, "not a string"),
    "no endpoint": (change('{endpoint: ["m:camera"]}', "{}"), 9, "'endpoint' is missing"),
    "not YAML": ("version: [1", 2, "not YAML"),
    "nothing": ("", 1, "empty"),
    "two documents": (GOOD + "---\na: 1\n", 22, "more than one document"),
}


@pytest.mark.parametrize(("text", "line", "part"), BAD.values(), ids=BAD.keys())
def test_a_mistake_is_named_with_its_line(text: str, line: int, part: str, tmp_path: Path) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(text, encoding="utf-8")
    report = inspect(file)
    assert report.robot is None
    (problem, *_) = [one for one in report.problems if part in str(one)] or list(report.problems)
    assert part in str(problem)
    assert problem.place.line == line
    assert str(problem).startswith(f"{file}:{line}:")


def test_all_mistakes_come_at_once_in_the_order_of_the_file() -> None:
    text = change("bridge: ros", "bridge: rose").replace("from: camera", "from: camara")
    with pytest.raises(ConfigurationError) as caught:
        loads(text)
    lines = str(caught.value).splitlines()
    assert len(lines) == 2
    assert "rose" in lines[0]
    assert "camara" in lines[1]


def chain(*edges: tuple[str, str]) -> str:
    text = "version: 1\nbridges: {python: {}}\nfunctions:\n"
    for function in dict.fromkeys(one for one, _ in edges):
        text += f"  {function}:\n    components:\n"
        for n, (_, need) in enumerate(edge for edge in edges if edge[0] == function):
            fed = f"input: {{from: {need}, endpoint: [x]}}, " if need else ""
            text += (
                f"      - {{name: {function}{n}, bridge: python, {fed}output: {{endpoint: [x]}}}}\n"
            )
    return text


def test_an_unavoidable_cycle_is_named_in_full() -> None:
    with pytest.raises(ConfigurationError, match="a -> b -> c -> a"):
        loads(chain(("a", "b"), ("b", "c"), ("c", "a")))


def test_an_avoidable_cycle_is_a_warning() -> None:
    robot = loads(chain(("a", "b"), ("b", "a"), ("b", "")))
    assert any("a -> b -> a" in warning for warning in robot.warnings)


def test_equal_priorities_and_idle_bridges_are_warnings() -> None:
    robot = loads(chain(("a", ""), ("a", "")).replace("{python: {}}", "{python: {}, idle: {}}"))
    assert any("priority 0: tried in this order" in one for one in robot.warnings)
    assert any("no component uses the bridge 'idle'" in one for one in robot.warnings)


def test_a_declared_structure_must_be_a_schema() -> None:
    text = change('{endpoint: ["m:camera"]}', '{endpoint: ["m:camera"], structure: {type: nought}}')
    with pytest.raises(ConfigurationError, match="not a JSON Schema"):
        loads(text)


def test_yes_and_on_are_words_and_numbers_are_of_yaml_1_2() -> None:
    text = change("{size: 3}", "{a: yes, b: on, c: 0o17, d: 0x1F, e: 1e3, f: 1:30, g: ~, h: 017}")
    (finder,) = loads(text).functions["faces"].components
    expected = {"a": "yes", "b": "on", "c": 15, "d": 31, "e": 1e3, "f": "1:30", "g": None, "h": 17}
    assert finder.parameters == expected


def test_a_bomb_of_aliases_ends() -> None:
    levels = "\n".join(f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 30))
    with pytest.raises(ConfigurationError, match="aliases unfolded"):
        loads(f"a0: &a0 [1]\n{levels}\n")


def test_deep_nesting_and_great_size_end() -> None:
    with pytest.raises(ConfigurationError, match="levels deep"):
        loads("a: " + "[" * 5000)
    with pytest.raises(ConfigurationError, match="are allowed"):
        loads("#" * 10_000_001)


@pytest.mark.parametrize("what", ["missing", "folder", "bytes"])
def test_a_file_that_cannot_be_read_is_one_clear_error(what: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    if what == "folder":
        path.mkdir()
    elif what == "bytes":
        path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigurationError, match=r"cannot be read|not UTF-8"):
        load(path)


@given(st.text(alphabet="ab:{}[]-&*!|>'\"# \n\t0,~", max_size=60))
def test_any_text_gives_a_robot_or_a_configuration_error(text: str) -> None:
    try:
        loads(text)
    except ConfigurationError as error:
        assert str(error)


@given(st.data())
def test_a_damaged_file_gives_a_robot_or_a_configuration_error(data: st.DataObject) -> None:
    at = data.draw(st.integers(0, len(GOOD) - 1))
    length = data.draw(st.integers(0, 12))
    extra = data.draw(st.sampled_from(["", "x", "[", "}", ": ", "\n", "- "]))
    try:
        loads(GOOD[:at] + extra + GOOD[at + length :])
    except ConfigurationError as error:
        assert str(error)
