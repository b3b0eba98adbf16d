"""What a bridge says of endpoints, as plans have it."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from uoarm._resolve import StructureCache, Structures
from uoarm._resolve._catalogue import Unavailable
from uoarm._support import deadlines
from uoarm.bridge import Bridge, Description
from uoarm.config import loads
from uoarm.model import Endpoint, MessageStructure
from uoarm.testing import patience, wait

ROBOT = loads("""
version: 1
bridges: {a: {plugin: memory}}
functions:
  camera:
    components:
      - name: camera
        bridge: a
        inputs: {light: {endpoint: [light], structure: {type: integer}}}
        output: {endpoint: [picture]}
""")


class Noting:
    """Knows two endpoints, of which a reader should know something."""

    def describe(self, endpoint: Endpoint, *, timeout: float) -> Description:
        del timeout
        return Description(
            MessageStructure({"type": "integer"}), note=f"{endpoint.address[0]} is slow"
        )


def test_what_a_reader_should_know_of_an_endpoint_is_in_the_plan() -> None:
    bridge: Bridge = Noting()  # type: ignore[assignment]  # as much of one as is asked
    found = StructureCache(lambda _: bridge).structures(ROBOT.functions["camera"].components[0])
    assert isinstance(found, Structures)
    assert found.warnings == (
        "camera.input.light: light is slow",
        "camera.input.light: the declared structure replaces the bridge's",
        "camera.output.default: picture is slow",
    )


def _circle() -> dict[str, object]:
    schema: dict[str, object] = {}
    schema["not"] = schema
    return schema


@pytest.mark.parametrize(
    ("schema", "expected"),
    [
        ("integer", "expected a schema"),
        ({"type": "integr"}, "#/type: expected a type of"),
        ({"$ref": "#/nowhere"}, "expected a reference to a part"),
        ({"enum": {1, 2}}, "type set"),
        ({"const": b"x"}, "type bytes"),
        ({1: {}}, "keywords that are text"),
        ({"items": {"pattern": "(\\w+)\\1+$"}}, "the pattern '(\\\\w+)\\\\1+$' is not decided"),
        (
            {"patternProperties": {"(?<=a)b": {}}},
            "the pattern '(?<=a)b' is not decided here: it looks behind",
        ),
        (_circle(), "Circular"),
    ],
)
def test_a_structure_that_is_no_schema_is_refused_before_anything_opens(
    schema: Any, expected: str
) -> None:
    class Lying(Noting):
        def describe(self, endpoint: Endpoint, *, timeout: float) -> Description:
            return Description(MessageStructure(schema))

    bridge: Bridge = Lying()  # type: ignore[assignment]  # as much of one as is asked
    found = StructureCache(lambda _: bridge).structures(ROBOT.functions["camera"].components[0])
    assert isinstance(found, Unavailable)
    assert "bridge 'a': structure 'output.default' cannot be used: " in found.sentence
    assert expected in found.sentence


class Hanging(Noting):
    """Says nothing until it is let."""

    def __init__(self) -> None:
        self.gate = threading.Event()

    def describe(self, endpoint: Endpoint, *, timeout: float) -> Description:
        limit = patience() if self.gate.is_set() else 0.01
        deadlines.run(f"describing {endpoint.address[0]}", limit, self.gate.wait)
        return super().describe(endpoint, timeout=timeout)


def test_one_that_does_not_answer_ends_no_step_around_it_and_is_not_asked_again_meanwhile() -> None:
    component, hangs = ROBOT.functions["camera"].components[0], Hanging()
    cache = StructureCache(lambda _: hangs)  # type: ignore[arg-type, return-value]  # as above

    def ask() -> str:
        found = cache.structures(component)
        return found.sentence if isinstance(found, Unavailable) else "found"

    assert "describing light did not finish" in deadlines.run("a request", patience(), ask)
    assert "has not answered what was asked before" in ask()
    hangs.gate.set()
    wait(lambda: ask() == "found")
