"""What must hold for every pair of schemas, whatever the checker's inside."""

from __future__ import annotations

from hypothesis import given
from hypothesis.strategies import DataObject, data
from tests.schema._finite import finite_schema
from tests.schema._hand_schemas import hand_schema
from tests.schema._judge import Body, answer, judge, other_validators_agree, shown
from tests.schema._reference import Reference
from tests.schema._rewrites import equivalent, loosened, negated, tightened
from tests.schema._strategies import Pair, pairs, schemas
from tests.schema._universe import universe

from uoarm.schema import CheckBudget, check
from uoarm.testing._instances import DrawnChoices, find_instance

EVERYTHING = tuple(universe())


@given(pairs, data())
def test_a_yes_has_no_counterexample_and_a_no_has_a_true_one(pair: Pair, more: DataObject) -> None:
    judge(*pair, DrawnChoices(more.draw), samples=8)


@given(pairs, data())
def test_no_value_of_a_small_universe_disproves_a_verdict(pair: Pair, more: DataObject) -> None:
    judge(*pair, DrawnChoices(more.draw), samples=0, universe=EVERYTHING)


@given(data())
def test_a_finite_producer_is_decided_exactly(more: DataObject) -> None:
    choices = DrawnChoices(more.draw)
    producer, instances = finite_schema(choices)
    consumer = choices.item((hand_schema(choices, 2), finite_schema(choices)[0]))
    for wanted in (consumer, negated(consumer)):
        accepts = Reference(wanted).accepts
        truth = "yes" if all(accepts(value) for value in instances) else "no"
        verdict = check(producer, wanted)
        assert answer(verdict) == truth, (truth, verdict.undecided, shown(producer, wanted))


@given(pairs)
def test_public_validators_see_a_counterexample_as_we_do(pair: Pair) -> None:
    verdict = check(*pair)
    if verdict.incompatible and not _reads_differ(pair, verdict.build_counterexample()):
        assert other_validators_agree(verdict.build_counterexample(), *pair), shown(*pair)


@given(schemas)
def test_every_schema_is_contained_in_itself(schema: Body) -> None:
    assert answer(check(schema, schema)) == "yes", shown(schema, schema)


@given(schemas, data())
def test_every_schema_lies_between_nothing_and_everything(schema: Body, more: DataObject) -> None:
    assert answer(check(False, schema)) == "yes"
    assert answer(check(schema, True)) == "yes"
    empty = check(schema, False)
    _, inhabited = find_instance(schema, DrawnChoices(more.draw), Reference(schema).accepts)
    if inhabited:
        assert not empty.compatible, shown(schema, False)


@given(schemas, data())
def test_equivalent_schemas_contain_each_other(schema: Body, more: DataObject) -> None:
    other = equivalent(DrawnChoices(more.draw), schema)
    for pair in ((schema, other), (other, schema)):
        verdict = check(*pair)
        assert not verdict.incompatible, (verdict.counterexample, shown(*pair))


@given(pairs, data())
def test_rewriting_either_side_keeps_the_verdict(pair: Pair, more: DataObject) -> None:
    choices = DrawnChoices(more.draw)
    producer, consumer = pair
    given_answer = answer(check(producer, consumer))
    rewritten = equivalent(choices, producer), equivalent(choices, consumer)
    new_answer = answer(check(*rewritten))
    assert "undecided" in {given_answer, new_answer} or given_answer == new_answer, (
        given_answer, new_answer, shown(*pair), shown(*rewritten),
    )  # fmt: skip


@given(schemas, data())
def test_a_tighter_producer_and_a_looser_consumer_are_never_refused(
    schema: Body, more: DataObject
) -> None:
    choices = DrawnChoices(more.draw)
    for pair in ((tightened(choices, schema), schema), (schema, loosened(choices, schema))):
        verdict = check(*pair)
        assert not verdict.incompatible, (verdict.counterexample, shown(*pair))


@given(pairs, data())
def test_verdicts_are_monotone(pair: Pair, more: DataObject) -> None:
    choices = DrawnChoices(more.draw)
    producer, consumer = pair
    given_answer = answer(check(producer, consumer))
    easier = tightened(choices, producer), loosened(choices, consumer)
    harder = loosened(choices, producer), tightened(choices, consumer)
    if given_answer == "yes":
        assert not check(*easier).incompatible, (shown(*pair), shown(*easier))
    if given_answer == "no":
        assert not check(*harder).compatible, (shown(*pair), shown(*harder))


@given(schemas, data())
def test_containment_is_transitive(schema: Body, more: DataObject) -> None:
    choices = DrawnChoices(more.draw)
    first = tightened(choices, equivalent(choices, schema))
    last = loosened(choices, equivalent(choices, schema))
    if check(first, schema).compatible and check(schema, last).compatible:
        assert not check(first, last).incompatible, shown(first, last)


@given(pairs)
def test_a_spent_budget_is_undecided_or_right(pair: Pair) -> None:
    full = answer(check(*pair))
    for steps in (0, 1, 10, 100):
        small = answer(check(*pair, budget=CheckBudget(steps=steps)))
        assert small in {full, "undecided"} or full == "undecided", (steps, shown(*pair))


@given(pairs)
def test_the_same_question_has_the_same_answer(pair: Pair) -> None:
    assert check(*pair).to_dict() == check(*pair).to_dict()


def _reads_differ(pair: Pair, value: object) -> bool:
    """Whether public validators read this otherwise: float division, and patterns by Python."""
    text = f"{pair}{value!r}"
    return any(sign in text for sign in ("multipleOf", "pattern", "\\n", "\\u2028", "."))
