"""What is reported of services, in any order: it stands until it is well, or ends."""

from __future__ import annotations

from collections.abc import Hashable

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule
from tests.calls import calls_of

from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.state import State
from uoarm._control.engine.step import step
from uoarm.model import FailoverPolicy, Health

BRIDGES = {"light": "one", "horn": "one", "gate": "two"}
PARTS: tuple[Hashable, ...] = ("component", ("component", "definition"), "messages")
ORDER = (Health.OK, Health.DEGRADED, Health.FINISHED, Health.LOST)
names = st.sampled_from(sorted(BRIDGES))


def report(name: str, health: Health, part: Hashable, cause: str = "") -> ev.HealthReported:
    """Return the report of a service, as the driver makes it."""
    avoided = part == "messages" and health is Health.LOST
    function = f"the function of {name}"
    return ev.HealthReported(
        BRIDGES.get(name, "one"), health, cause, name, part, is_avoided=avoided, function=function
    )


class Reports(RuleBasedStateMachine):
    """Reports of services and of their bridges, and changes of configuration."""

    @initialize()
    def begin(self) -> None:
        self.state = State(FailoverPolicy(), dict(BRIDGES))
        self.reported: dict[str, dict[Hashable, Health]] = {name: {} for name in BRIDGES}
        self.avoided: set[str] = set()
        self.revision = 0
        self.number = 0

    def post(self, event: ev.Event) -> list[act.Announce]:
        self.state, actions = step(self.state, event, 1.0)
        return [action for action in actions if isinstance(action, act.Announce)]

    def worst(self, name: str) -> Health:
        return max(self.reported[name].values(), key=ORDER.index, default=Health.OK)

    @rule(name=names, health=st.sampled_from(ORDER), part=st.sampled_from(PARTS))
    def is_reported(self, name: str, health: Health, part: Hashable) -> None:
        before = self.worst(name)
        self.number += 1
        announced = self.post(report(name, health, part, f"cause {self.number}"))
        self.reported[name][part] = health
        if part == "messages" and health is Health.LOST:
            self.avoided.add(name)
        elif health is Health.OK and self.worst(name) is not Health.LOST:
            self.avoided.discard(name)
        if self.worst(name) is before is Health.OK:
            assert not announced
        elif self.worst(name) is not before or health is self.worst(name):
            [news] = announced
            assert (news.subject, news.function) == (f"component {name}", f"the function of {name}")
            assert news.change == self.worst(name).value
            assert news.cause == f"cause {self.number}" or health is not self.worst(name)

    @rule(bridge=st.sampled_from(("one", "two")), health=st.sampled_from(ORDER))
    def is_reported_of_the_bridge(self, bridge: str, health: Health) -> None:
        self.post(ev.HealthReported(bridge, health, "it is so"))
        if health is Health.LOST:  # another one knows nothing of what the one before has said
            for name in (name for name, its in BRIDGES.items() if its == bridge):
                raised = self.reported[name].get("messages", Health.OK)
                self.reported[name] = {"messages": raised}

    @rule(name=names)
    def is_another_from_now_on(self, name: str) -> None:
        self.revision += 1
        changed, policy = frozenset({name}), self.state.policy
        self.post(ev.Configured(self.revision, "waiter", policy, BRIDGES, changed, frozenset()))
        self.reported[name] = {}
        self.avoided.discard(name)

    @rule(name=names)
    def is_another_candidate_from_now_on(self, name: str) -> None:
        number = self.state.candidates + 1
        self.post(ev.CandidatesChanged(BRIDGES, "so it is", number, frozenset({name})))
        self.reported[name] = {}

    @invariant()
    def each_is_as_it_was_reported(self) -> None:
        known = {name: health.health for name, health in self.state.services.items()}
        worst = {name: self.worst(name) for name in BRIDGES}
        assert known == {name: health for name, health in worst.items() if health is not Health.OK}
        assert set(self.state.avoided) == self.avoided


TestReports = Reports.TestCase
TestReports.settings = settings(stateful_step_count=30, max_examples=200)


def test_a_report_of_one_service_costs_the_same_beside_few_and_beside_many() -> None:
    spent = []
    for others in (40, 640):
        bridges = {f"s{number}": "one" for number in range(others)}
        state = State(FailoverPolicy(), bridges)
        for name in bridges:
            state, _ = step(state, report(name, Health.LOST, "component"), 1.0)
        event = report("s0", Health.OK, "component")
        spent.append(calls_of(lambda: step(state, event, 2.0)))  # noqa: B023 - at once
    assert spent[1] <= 1.1 * spent[0]
