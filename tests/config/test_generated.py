"""Configurations that hypothesis makes, whole and damaged: read, or refused with a place."""

from __future__ import annotations

import json
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from tests.config.test_limits import problems_of
from tests.config.test_load import FULL

from uoarm.config import loads

NAMES = st.from_regex(r"[A-Za-z_][A-Za-z0-9_-]{0,6}", fullmatch=True)
TEXT = st.text(st.characters(max_codepoint=0xFFFF, exclude_categories=["Cs"]), max_size=6)
"""Beyond U+FFFF JSON writes pairs of escapes, which YAML does not join."""
OPTIONS = st.dictionaries(TEXT, st.none() | st.integers() | TEXT)
ENDPOINTS = st.lists(TEXT, min_size=1, max_size=3)
STRUCTURES = st.sampled_from([True, {"type": "object"}, {"enum": [1, "a"]}, {"items": False}])
OUTPUTS = st.fixed_dictionaries(
    {"endpoint": ENDPOINTS}, optional={"options": OPTIONS, "structure": STRUCTURES}
)


@st.composite
def configurations(draw: st.DrawFn) -> dict[str, object]:
    """A valid configuration, in which a function needs only functions before it."""
    bridges = draw(st.lists(NAMES, min_size=1, max_size=3, unique=True))
    functions: dict[str, object] = {}
    for number, name in enumerate(draw(st.lists(NAMES, max_size=6, unique=True))):
        inputs = {
            port: {
                "endpoint": draw(ENDPOINTS),
                **({"from": f"{draw(st.sampled_from(list(functions)))}.out"} if functions else {}),
            }
            for port in draw(st.lists(NAMES, max_size=2, unique=True))
        }
        component = {
            "name": f"c{number}",
            "bridge": draw(st.sampled_from(bridges)),
            "priority": draw(st.integers(-1_000_000, 1_000_000)),
            **({"inputs": inputs} if inputs else {}),
            "outputs": {"out": draw(OUTPUTS), **draw(st.dictionaries(NAMES, OUTPUTS, max_size=2))},
        }
        functions[name] = {"components": [component]}
    return {"version": 1, "bridges": {name: {} for name in bridges}, "functions": functions}


@given(configurations())
def test_every_generated_configuration_is_read_whole(configuration: dict[str, object]) -> None:
    robot = loads(json.dumps(configuration, ensure_ascii=True))
    functions = configuration["functions"]
    assert isinstance(functions, dict)
    assert list(robot.functions) == list(functions)
    for name, function in functions.items():
        written = function["components"][0]
        component = robot.functions[name].components[0]
        assert component.priority == written["priority"]
        assert {output.name: list(output.endpoint.address) for output in component.outputs} == {
            port: output["endpoint"] for port, output in written["outputs"].items()
        }
        assert {
            input_.name: str(input_.source) for input_ in component.inputs if input_.source
        } == {
            port: input_["from"]
            for port, input_ in written.get("inputs", {}).items()
            if "from" in input_
        }


JUNK: st.SearchStrategy[object] = st.sampled_from(
    [None, True, 0, -1, 1.5, "", "zzz", [], {}, [{}], {"x": 1}, [[]], "a.b.c"]
)


@given(configurations(), st.data())
def test_a_damaged_configuration_is_read_or_refused(
    configuration: dict[str, object], data: st.DataObject
) -> None:
    target: Any = configuration
    while True:
        keys = list(target) if isinstance(target, dict) else list(range(len(target)))
        key = data.draw(st.sampled_from(keys))
        inner = target[key]
        if not isinstance(inner, dict | list) or not inner or data.draw(st.booleans()):
            target[key] = data.draw(JUNK)
            break
        target = inner
    text = json.dumps(configuration)
    assert all(line.startswith(("<text>:1:", "... and ")) for line in problems_of(text))


@given(st.data())
def test_a_file_with_a_slip_of_the_keyboard_is_read_or_refused(data: st.DataObject) -> None:
    at = data.draw(st.integers(0, len(FULL) - 1))
    length = data.draw(st.integers(0, 12))
    extra = data.draw(st.sampled_from(["", "x", "[", "}", ": ", "\n", "- ", "\t", "*a", "&a "]))
    text = FULL[:at] + extra + FULL[at + length :]
    assert all(line.startswith(("<text>:", "... and ")) for line in problems_of(text))
