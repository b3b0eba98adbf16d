"""Objects in which one member must meet several demands."""

from __future__ import annotations

from typing import Any

import pytest

from uoarm.schema import check

STRING: dict[str, Any] = {"type": "string"}
NUMBER: dict[str, Any] = {"type": "number"}
ONE: dict[str, Any] = {"type": "object", "maxProperties": 1}


def named(pattern: str) -> dict[str, Any]:
    """Some member has a name that the pattern finds."""
    return {"not": {"propertyNames": {"not": {"pattern": pattern}}}}


def valued(pattern: str, value: dict[str, Any]) -> dict[str, Any]:
    """Some member whose name the pattern finds has such a value."""
    return {"not": {"patternProperties": {pattern: {"not": value}}}}


@pytest.mark.parametrize(
    ("producer", "consumer"),
    [
        ({"maxProperties": 1, "not": {"const": {}}}, {"additionalProperties": False}),
        (
            {"allOf": [{"not": {"additionalProperties": False}}, {"maxProperties": 1}]},
            {"propertyNames": False},
        ),
        (
            {"type": "object", "propertyNames": {"const": "x"}, "not": {"const": {}}},
            {"additionalProperties": False},
        ),
    ],
)
def test_one_member_serves_two(producer: dict[str, Any], consumer: dict[str, Any]) -> None:
    """Each demand once had a member of its own, and there was room for one: a wrong yes."""
    assert len(check(producer, consumer).counterexample) == 1


@pytest.mark.parametrize("patterns", ["ab", "abc", "cba"])
def test_one_name_is_found_for_all_patterns(patterns: str) -> None:
    verdict = check({"allOf": [ONE, *map(named, patterns)]}, False)
    (name,) = verdict.counterexample
    assert set(patterns) <= set(name)


def test_of_two_names_each_gets_the_demand_that_only_it_can_meet() -> None:
    words = {"type": "object", "propertyNames": {"enum": ["x", "y"]}}
    demands = [valued("^[xy]$", STRING), valued("^x$", NUMBER)]
    for order in (demands, demands[::-1]):
        found = check({"allOf": [words, *order]}, False).counterexample
        assert isinstance(found["y"], str)
        assert not isinstance(found["x"], str)


def test_what_one_member_cannot_meet_needs_two() -> None:
    demands = [named("a"), {"not": {"propertyNames": {"pattern": "a"}}}]
    assert check({"allOf": [ONE, *demands]}, False).compatible
    assert len(check({"allOf": [{**ONE, "maxProperties": 2}, *demands]}, False).counterexample) == 2


@pytest.mark.parametrize(("rest", "left"), [(False, 0), ({"type": "integer"}, "")])
def test_patterns_of_names_that_a_branch_evaluates_do_so_only_where_it_holds(
    rest: Any, left: Any
) -> None:
    way = {"required": ["k"], "patternProperties": {"^x": True}}
    consumer = {
        "type": "object",
        "properties": {"k": True},
        "anyOf": [way, True],
        "unevaluatedProperties": rest,
    }

    def named(pattern: str, **more: Any) -> dict[str, Any]:
        return {"type": "object", "propertyNames": {"pattern": pattern}} | more

    assert check(named("^(k|x.*)$", required=["k"]), consumer).compatible
    assert set(check(named("^(k|y|x.*)$", required=["k"]), consumer).counterexample) == {"k", "y"}
    refused = check(named("^x", additionalProperties={"const": left}), consumer).counterexample
    assert list(refused.values()) == [left]
