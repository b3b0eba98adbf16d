"""The work of a check grows with the file, whatever it holds: calls are counted, not seconds."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from jsonschema import Draft202012Validator
from tests.calls import calls_of

from uoarm.bridge import BridgeType, Registry
from uoarm.config import inspect, loads
from uoarm.config._shape import _validator
from uoarm.errors import ConfigurationError
from uoarm.testing import MemoryBridge

HEAD = "version: 1\nbridges: {p: {plugin: python}}\n"
EMPTY = HEAD + "functions: {}\n"
OUTPUT = "output: {endpoint: ['x:y'], structure: {type: object, properties: {a: {type: integer}}}}"
COMPONENT = "{name: c@, bridge: p, " + OUTPUT + "}"


def fed(source: str) -> str:
    return COMPONENT[:-1] + ", input: {from: f" + source + ", endpoint: [a]}}"


def each(part: str, between: str = ", ") -> Callable[[int], str]:
    """Return what writes a part many times; in it stands @ for its number, < and > for others."""

    def write(count: int) -> str:
        return between.join(
            part.replace("@", str(n))
            .replace("<", str(max(n - 1, 0)))
            .replace(">", str((n + 1) % count))
            for n in range(count)
        )

    return write


def within(before: str, part: Callable[[int], str], after: str = "") -> Callable[[int], str]:
    return lambda count: before + part(count) + after


def functions(components: str) -> Callable[[int], str]:
    return within(HEAD + "functions:\n", each(f"  f@: {{components: [{components}]}}", "\n"))


def structure(part: Callable[[int], str], around: str) -> Callable[[int], str]:
    before, after = around.split("...")
    component = "functions: {f: {components: [{name: c, bridge: p, output: {endpoint: ['x:y'], "
    return within(f"{HEAD}{component}structure: {{{before}", part, f"{after}}}}}}}]}}}}")


def listed(key: str, item: str) -> Callable[[int], str]:
    """Return what writes functions, and a key that names each of them."""
    made, before, after = functions(COMPONENT), *key.split("...")
    return lambda count: f"{made(count)}\n{before}{each(item)(count)}{after}"


SHAPES = {
    "offers": listed("offer: {p: {...}}", "f@: {output: {endpoint: ['x:y']}}"),
    "offers in other bridges": listed("offer: {...}", "q@: {f@: {output: {endpoint: [a]}}}"),
    "applications of functions": listed("applications: {...}", "a@: {needs: [f@]}"),
    "an application of all": listed("applications: {a: {needs: [...]}}", "f@"),
    "exports": listed("export: {all: [...]}", "f@"),
    "recorded": listed("record: {functions: [...], path: a}", "f@"),
    "machines": within(
        "version: 1\nfunctions: {}\nhosts: {listen: tls/127.0.0.1:1, certificates: a}\nbridges: {",
        each("b@: {plugin: python, host: {machine: m@}}"),
        "}",
    ),
    "discovered": within(
        HEAD + "functions:\n", each("  f@: {needs: {structure: {type: integer}}}", "\n")
    ),
    "types of parameters": functions(COMPONENT[:-1] + ", parameters: {a: @}}"),
    "inputs": within(
        HEAD + "functions: {f: {components: [{name: c, bridge: p, inputs: {",
        each("i@: {endpoint: [a]}"),
        "}}]}}",
    ),
    "inputs of outputs": within(
        HEAD + "functions: {f: {components: [{name: c, bridge: p, inputs: {",
        each("i@: {from: f.o@, endpoint: [a]}"),
        "}}]}}",
    ),
    "failover of functions": listed("failover: {failing: {...}}", "f@: 1"),
    "functions": functions(COMPONENT),
    "functions without components": functions(""),
    "components": within(HEAD + "functions: {f: {components: [", each(COMPONENT), "]}}"),
    "components of one name": within(HEAD + "functions: {f: {components: [", each("{}"), "]}}"),
    "a chain": functions(fed("<")),
    "a ring": functions(fed(">")),
    "a star": functions(fed("0")),
    "unknown keys": within(EMPTY, each("kk@: 1\n", "")),
    "one key again and again": within(EMPTY, each("functions: {}\n", "")),
    "bridges": within("version: 1\nfunctions: {}\nbridges: {", each("b@: {}"), "}"),
    "applications": within(EMPTY + "applications: {", each("a@: {needs: [f]}"), "}"),
    "needs": within(EMPTY + "applications: {a: {needs: [", each("{x: @}"), "]}}"),
    "required": structure(each("{x: @}"), "required: [...]"),
    "types": structure(each("[@]"), "type: [...]"),
    "definitions": structure(each("d@: {$ref: '#/$defs/d>'}"), "$defs: {...}"),
}


def calls(text: str) -> int:
    """Return how many functions were called and left again while a configuration was read."""
    types = Registry().types

    def read() -> None:
        with suppress(ConfigurationError):
            loads(text, types=types)

    return calls_of(read)


@pytest.mark.parametrize("shape", SHAPES)
def test_twice_as_much_costs_twice_as_much(shape: str) -> None:
    make = SHAPES[shape]
    calls(make(2))  # what is imported and made once, also for a plugin that is not there
    assert calls(make(200)) < 2.3 * calls(make(100))


def test_what_plugins_doubt_of_twice_as_many_bridges_costs_twice_as_much(tmp_path: Path) -> None:
    kind = BridgeType(
        "memory", "", lambda *_: MemoryBridge("lab"), contract=2, doubts=lambda *_: {}
    )
    file = tmp_path / "robot.yaml"
    component = COMPONENT.replace("bridge: p", "bridge: b@")

    def checked(count: int) -> int:
        bridges = each("b@: {plugin: memory}")(count)
        made = each(f"  f@: {{components: [{component}]}}", "\n")(count)
        file.write_text(f"version: 1\nbridges: {{{bridges}}}\nfunctions:\n{made}\n")
        return calls_of(lambda: inspect(file, {"memory": kind}, missing=str))

    checked(2)
    assert checked(200) < 2.3 * checked(100)


@pytest.mark.parametrize("kind", ["[0]", "{a: 1}", "[]", "null"])
def test_a_type_that_is_none_is_a_mistake_like_any_other(kind: str) -> None:
    text = structure(lambda _: f"[{kind}]", "type: ...")(1)
    with pytest.raises(ConfigurationError, match=r"structure\.type: not a JSON Schema: expected"):
        loads(text, types=Registry().types)


SCALARS = st.none() | st.booleans() | st.sampled_from([0, 1, 2, 0.0, 1.0, 0.5, "", "a", "1"])
VALUES = st.recursive(
    SCALARS,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from("ab"), inner, max_size=2)
    ),
)


@given(st.lists(VALUES, max_size=6))
def test_what_stands_twice_is_reported_as_json_schema_has_it(values: Any) -> None:
    ours = _validator({"uniqueItems": True}).is_valid(values)
    assert ours == Draft202012Validator({"uniqueItems": True}).is_valid(values)
