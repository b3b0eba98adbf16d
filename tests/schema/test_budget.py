"""One budget for the whole check: counted in steps, time and octets, whatever the schemas are."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import pytest
from tests.harness._places import unmeasured
from tests.schema._hostile import HOSTILE, chain, choices, rows
from tests.schema._reference import Reference

from uoarm.schema import CheckBudget, check
from uoarm.schema._decide import find_losses
from uoarm.schema._errors import BudgetError, Meter
from uoarm.schema.read import Pool, SchemaDocument
from uoarm.schema.regex import walker_of
from uoarm.schema.solve._branch import Branch
from uoarm.schema.solve._numbers import find_number_whole
from uoarm.schema.solve._solver import SearchState

PATIENT = 1_000.0
"""Seconds that no check takes: steps or octets end it, not the clock of a busy machine."""
ANY: dict[str, object] = {"type": "integer"}


@pytest.mark.parametrize("depth", [21, 60, 400])
def test_a_chain_that_doubles_costs_its_length(depth: int) -> None:
    verdict = check(*chain(depth), budget=CheckBudget(steps=100 * depth, seconds=PATIENT))
    assert verdict.incompatible
    assert verdict.abridged
    assert verdict.counterexample is None
    assert len(str(verdict.to_dict())) < 50_000


@pytest.mark.parametrize(
    ("producer", "consumer"),
    [
        (rows(3_900_000, {"type": "string"}), rows(0, ANY)),
        (rows(4_000_000, rows(4_000_000, rows(4_000_000, ANY))), {"maxItems": 7}),
        (rows(4_000_000, {"type": "string", "minLength": 4_000_000}), False),
        (rows(3_000_000, ANY), {"uniqueItems": True}),
        ({"prefixItems": [{"const": "x"}], **rows(2_000_000, ANY)}, {"prefixItems": [ANY]}),
        (rows(2_000_000, ANY), {"items": {"minimum": 1}}),
    ],
)
def test_a_long_counterexample_is_reported_and_not_built(producer: Any, consumer: Any) -> None:
    verdict = check(producer, consumer, budget=CheckBudget(steps=2_000, seconds=PATIENT))
    assert verdict.incompatible
    assert verdict.abridged
    assert verdict.counterexample is None
    assert len(str(verdict.to_dict())) < 5_000
    assert "more of the same" in str(verdict.to_dict()["counterexample"])


def test_a_long_counterexample_is_built_when_asked_for() -> None:
    producer = {"prefixItems": [{"const": "x"}], **rows(30_000, {"type": "array", "minItems": 2})}
    consumer = {"maxItems": 7}
    built = check(producer, consumer, budget=CheckBudget(seconds=PATIENT)).build_counterexample()
    assert built[0] == "x"
    assert built[1:] == [[0, 0]] * 29_999 or len(built) == 30_000
    assert Reference(producer).accepts(built)
    assert not Reference(consumer).accepts(built)


_PICK = random.Random(1)
LONG = "".join(_PICK.choice("ab") for _ in range(3_000))
HAS_LONG = {"type": "object", "properties": {LONG: ANY}, "required": [LONG]}


@pytest.mark.parametrize("pattern", [f"a{'[ab]' * 200}c", f"^(?=[ab]*a{'[ab]' * 200}c)"])
@pytest.mark.parametrize(
    ("producer", "place"),
    [
        ({"const": LONG}, lambda item: {"pattern": item}),
        ({"const": [LONG]}, lambda item: {"items": {"pattern": item}}),
        ({"const": {LONG: 1}}, lambda item: {"patternProperties": {item: {"type": "string"}}}),
        (
            {"const": {LONG: 1}},
            lambda item: {"patternProperties": {item: ANY}, "additionalProperties": {"minimum": 7}},
        ),
        ({"const": {LONG: 1}}, lambda item: {"propertyNames": {"pattern": item}}),
        (HAS_LONG, lambda item: {"patternProperties": {item: {"type": "string"}}}),
        (
            HAS_LONG,
            lambda item: {"patternProperties": {item: ANY}, "unevaluatedProperties": False},
        ),
    ],
)
def test_a_pattern_with_much_to_do_at_each_character_ends_within_the_budget(
    producer: Any, place: Callable[[str], Any], pattern: str
) -> None:
    walker, steps = walker_of(pattern), 1_000
    before = walker.work[0]
    verdict = check(producer, place(pattern), budget=CheckBudget(steps=steps, seconds=PATIENT))
    assert str(verdict.undecided).startswith("the budget of steps ran out")
    assert walker.work[0] - before < 8 * steps + 4_000, "threads that were followed"


def deep_object(levels: int) -> dict[str, object]:
    """A schema whose messages have more levels than its text."""
    defs: dict[str, object] = {f"d{levels}": ANY}
    for n in range(levels):
        inner = {"a": {"$ref": f"#/$defs/d{n + 1}"}}
        defs[f"d{n}"] = {"type": "object", "properties": inner, "required": ["a"]}
    return {"$defs": defs, "$ref": "#/$defs/d0"}


@pytest.mark.parametrize("levels", [200, 1_500])
def test_a_deep_counterexample_is_reported_in_a_form_that_json_can_write(levels: int) -> None:
    verdict = check(deep_object(levels), {"type": "string"}, budget=CheckBudget(seconds=PATIENT))
    assert verdict.incompatible
    assert verdict.abridged is (levels > 250)
    assert len(json.dumps(verdict.to_dict())) < 10_000
    built = verdict.build_counterexample()
    for _ in range(levels):
        built = built["a"]
    assert built == 0


def losing(fields: int) -> tuple[Any, Any]:
    """Fields that the consumer does not know, and as many patterns to find them by."""
    ours = {"properties": {f"f{n}": {"type": "integer"} for n in range(fields)}}
    theirs: dict[str, object] = {
        "properties": {"x": {}},
        "patternProperties": {f"^g{n}$": {} for n in range(4)},
    }
    return {"type": "object", **ours}, {"type": "object", **theirs}


def test_what_is_lost_is_reported_within_the_budget() -> None:
    """Less of it is reported where the budget ends; what was proven stays."""
    whole = check(*losing(200), budget=CheckBudget(seconds=PATIENT))
    assert whole.compatible
    assert len(whole.losses) == 200
    pool = Pool(Meter(10**6, PATIENT, 10**9))
    producer, consumer = (SchemaDocument(item, pool).root for item in losing(200))
    for steps, octets in ((500, 10**9), (10**6, 30_000)):
        assert 0 < len(find_losses(producer, consumer, Meter(steps, PATIENT, octets))) < 200
    assert not find_losses(producer, consumer, Meter(0, PATIENT, 10**9))


def test_what_is_lost_is_reported_beside_patterns_that_are_not_decided() -> None:
    one = {"properties": {"a": ANY}, "patternProperties": {"(?<=a)b": ANY}}
    patient = CheckBudget(seconds=PATIENT)
    assert check({"allOf": [one], "properties": {"a": ANY}}, one, budget=patient).compatible
    assert check(one, one, budget=patient).compatible


def test_a_short_one_is_there_at_once() -> None:
    verdict = check(rows(500, ANY), {"maxItems": 7}, budget=CheckBudget(seconds=PATIENT))
    assert not verdict.abridged
    assert verdict.counterexample == verdict.build_counterexample() == [0] * 500


def test_a_shared_constant_costs_what_it_takes_to_store() -> None:
    for name, fits in (
        ("constant of 2**40 items into itself", True),
        ("constant of 2**40 items, shared", False),
    ):
        verdict = check(*HOSTILE[name](), budget=CheckBudget(steps=5_000, seconds=PATIENT))
        assert verdict.compatible is fits
        assert verdict.undecided is None


MANY = 100_000


@pytest.mark.parametrize(
    ("producer", "consumer", "fits"),
    [
        ({"type": "integer", "minimum": 0, "maximum": MANY - 1}, list(range(MANY)), True),
        ({"type": "integer", "minimum": 0, "maximum": MANY}, list(range(MANY)), False),
        ({"enum": list(range(1, MANY))}, list(range(MANY)), True),
        ({"enum": [n / 7 for n in range(MANY)]}, [n / 7 for n in reversed(range(MANY))], True),
        pytest.param(
            {"enum": [n / 7 for n in range(MANY)]},
            [n / 7 for n in range(MANY - 1)],
            False,
            marks=pytest.mark.long,
        ),
    ],
)
def test_a_hundred_thousand_numbers_are_few_steps(producer: Any, consumer: Any, fits: bool) -> None:
    verdict = check(
        producer, {"enum": consumer}, budget=CheckBudget(steps=5 * MANY, seconds=PATIENT)
    )
    assert (verdict.compatible, verdict.undecided) == (fits, None)


def test_some_hundred_choices_are_decided() -> None:
    objects = {"anyOf": [{"type": "object", "required": [f"f{n}"]} for n in range(500)]}
    verdict = check(
        objects, {"type": "object", "minProperties": 1}, budget=CheckBudget(seconds=PATIENT)
    )
    assert verdict.compatible
    verdict = check(*choices(50), budget=CheckBudget(seconds=PATIENT))
    assert (verdict.compatible, verdict.undecided) == (False, None)


@pytest.mark.long
@pytest.mark.parametrize("name", ["anyOf of 20,000", "anyOf of 20,000 records", "500 open choices"])
def test_many_choices_are_decided(name: str) -> None:
    verdict = check(*HOSTILE[name](), budget=CheckBudget(seconds=PATIENT))
    assert verdict.compatible is ("anyOf" in name)
    assert verdict.undecided is None


def clocked(seconds: float) -> Meter:
    """A meter whose clock is one second on each time that it is read."""
    ticks = count()
    return Meter(10**9, seconds, 10**9, clock=lambda: next(ticks))


def spend_often(meter: Meter, steps: int) -> None:
    for _ in range(2_000):
        meter.spend(steps)


def test_what_ran_out_is_reported_with_the_part_that_took_longest() -> None:
    meter = clocked(50.0)
    with meter.part("the search"), pytest.raises(BudgetError, match=r"time.*the search"):
        spend_often(meter, 1)
    with pytest.raises(BudgetError, match="memory"):
        Meter(10, 1.0, 1_000).hold(1_001)
    with pytest.raises(BudgetError, match="steps"):
        Meter(10, 1.0, 1_000).spend(11)


@pytest.mark.parametrize("step", [1, 3, 7, 64, 1_000])
def test_the_clock_is_read_often_however_steps_are_counted(step: int) -> None:
    with pytest.raises(BudgetError, match="time"):
        spend_often(clocked(10.0), step)


MANY_PARTS = [{"type": "integer", "minimum": n} for n in range(2_000)]


@pytest.mark.parametrize(
    ("schema", "sign"),
    [({"anyOf": MANY_PARTS}, True), ({"anyOf": MANY_PARTS}, False), ({"allOf": MANY_PARTS}, False)],
)
def test_the_clock_is_read_while_a_goal_of_many_schemas_is_broken_into_demands(
    schema: dict[str, object], sign: bool
) -> None:
    ticks = count()
    pool = Pool(Meter(10**9, 10**9, 10**9, clock=lambda: next(ticks)))
    root = SchemaDocument(schema, pool).root
    numbers = {node.number for node in root.applied()}
    assert len(numbers) == len(MANY_PARTS)
    before = next(ticks)
    SearchState("number", ()).add(Branch(literals=[(root, sign)]))
    assert next(ticks) > before + 1


def test_the_clock_is_read_while_the_steps_of_many_numbers_are_gathered() -> None:
    pool = Pool(Meter(10**9, 10**9, 10**9))
    goal = ((SchemaDocument({"anyOf": MANY_PARTS, "multipleOf": 7}, pool).root, True),)

    def spend(steps: int) -> None:
        raise BudgetError(f"at the first of {steps}")

    with pytest.raises(BudgetError) as ended:
        find_number_whole(goal, spend)
    assert any(entry.name == "_steps" for entry in ended.traceback)


@pytest.mark.parametrize("name", HOSTILE)
def test_few_steps_end_a_check_at_once(name: str) -> None:
    """Whatever is not counted would go on; the limit of the test run is what notices."""
    pair = HOSTILE[name]()
    for steps in (0, 100, 2_000):
        check(*pair, budget=CheckBudget(steps=steps, seconds=PATIENT))


LIMITED = """
import resource, sys
from tests.schema._hostile import HOSTILE
from uoarm.schema import CheckBudget, check
for name, make in HOSTILE.items():
    pair = make()
    pages = int(open("/proc/self/statm").read().split()[0])
    room = pages * resource.getpagesize() + 2**28
    resource.setrlimit(resource.RLIMIT_AS, (room, resource.RLIM_INFINITY))
    try:
        check(*pair, budget=CheckBudget(steps=8_000, seconds=1_000))
    except MemoryError:
        print(name)
    resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
"""
FLAT = """
import sys
from tests.schema._hostile import HOSTILE, deep
from uoarm.schema import CheckBudget, check
nested = "(?:a" * 400 + ")" * 400
looks = "(?=a" * 8 + ")" * 8
pairs = {name: make() for name, make in HOSTILE.items()}
pairs["groups"] = {"pattern": nested}, {"pattern": nested + "b"}
pairs["looks"] = {"pattern": looks}, {"pattern": looks + "b"}
pairs["malformed"] = {"enum": deep(400)}, True
check({"type": "integer", "pattern": "a"}, {"type": "string"})  # imports what it needs
depth, frame = 0, sys._getframe()
while frame:
    depth, frame = depth + 1, frame.f_back
sys.setrecursionlimit(depth + 60)
for name, pair in pairs.items():
    try:
        check(*pair, budget=CheckBudget(steps=8_000, seconds=1_000)).to_dict()
    except RecursionError:
        print(name)
    except ValueError as error:
        assert name == "malformed", (name, error)
"""


@pytest.mark.parametrize("code", [LIMITED, FLAT], ids=["memory", "recursion"])
def test_neither_memory_nor_the_stack_runs_out(code: str) -> None:
    """In a process that may grow by 256 MB, and in one whose stack has room for sixty frames."""
    root = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=root, capture_output=True, text=True, check=False,
        env=unmeasured(),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-2_000:]
    assert done.stdout == ""
