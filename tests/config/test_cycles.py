"""Cycles: what can be grounded, and that the cycle in the report is one."""

from __future__ import annotations

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from uoarm.config._loops import Needs, avoidable_cycles, unavoidable_cycles

NAMES = "abcdef"
NEEDS = st.dictionaries(
    st.sampled_from(NAMES),
    st.lists(st.frozensets(st.sampled_from(NAMES), max_size=3), min_size=1, max_size=3),
    min_size=1,
).map(lambda needs: {name: [w & needs.keys() for w in ws] for name, ws in needs.items()})


def grounded(needs: Needs) -> set[str]:
    """Which functions can be grounded, by asking again until nothing changes."""
    found: set[str] = set()
    while True:
        more = {name for name, ws in needs.items() if any(wanted <= found for wanted in ws)}
        if more == found:
            return found
        found = more


def reaches(needs: Needs, start: str, end: str) -> bool:
    seen: set[str] = set()
    waiting = [start]
    while waiting:
        for other in set().union(*needs[waiting.pop()]):
            if other == end:
                return True
            if other not in seen:
                seen.add(other)
                waiting.append(other)
    return False


@given(NEEDS)
def test_there_is_an_unavoidable_cycle_exactly_when_something_cannot_be_grounded(
    needs: Needs,
) -> None:
    assert bool(unavoidable_cycles(needs)) == (grounded(needs) != needs.keys())


@given(NEEDS)
def test_every_reported_cycle_is_a_cycle(needs: Needs) -> None:
    good = grounded(needs)
    for cycle in unavoidable_cycles(needs):
        assert good.isdisjoint(cycle)
    for cycle in avoidable_cycles(needs):
        assert good.issuperset(cycle)
    for cycle in [*unavoidable_cycles(needs), *avoidable_cycles(needs)]:
        assert cycle[0] == cycle[-1]
        assert len(set(cycle)) == len(cycle) - 1
        for name, other in pairwise(cycle):
            assert other in set().union(*needs[name])


@given(NEEDS)
def test_avoidable_cycles_are_reported_where_grounded_functions_reach_themselves(
    needs: Needs,
) -> None:
    good = grounded(needs)
    among = {name: [w & good for w in ws] for name, ws in needs.items() if name in good}
    assert bool(avoidable_cycles(needs)) == any(reaches(among, name, name) for name in among)


def test_each_independent_knot_is_reported_once() -> None:
    needs = {
        "a": [frozenset("b")],
        "b": [frozenset("a")],
        "c": [frozenset("c")],
        "d": [frozenset("ac")],
    }
    assert unavoidable_cycles(needs) == [("a", "b", "a"), ("c", "c")]


def test_what_only_waits_for_another_knot_is_not_reported() -> None:
    needs = {"c": [frozenset("d")], "d": [frozenset("c"), frozenset("a")], "a": [frozenset("a")]}
    assert unavoidable_cycles(needs) == [("a", "a")]


def test_a_ring_of_ten_thousand_is_found_without_recursion() -> None:
    size = 10_000
    needs = {str(n): [frozenset([str((n + 1) % size)])] for n in range(size)}
    (cycle,) = unavoidable_cycles(needs)
    assert len(cycle) == size + 1
