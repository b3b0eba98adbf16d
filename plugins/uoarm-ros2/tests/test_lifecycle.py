"""What a lifecycle node is asked, in every order that the decision allows; no node is there."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st
from uoarm_ros2._managed_nodes import Lifecycle, Transition

from uoarm.model import Health

CONFIGURE, CLEANUP = Transition.CONFIGURE, Transition.CLEANUP
ACTIVATE, DEACTIVATE = Transition.ACTIVATE, Transition.DEACTIVATE
GOAL = {
    CONFIGURE: ("unconfigured", "inactive"),
    ACTIVATE: ("inactive", "active"),
    DEACTIVATE: ("active", "inactive"),
    CLEANUP: ("inactive", "unconfigured"),
}
STATES = ("unconfigured", "inactive", "active")


class Node:
    """A node as simple as can be; what does not fit its state ends it."""

    def __init__(self, state: str) -> None:
        self.state = state
        self.asked: list[Transition] = []

    def change(self, transition: Transition) -> None:
        before, after = GOAL[transition]
        assert self.state == before
        self.asked.append(transition)
        self.state = after

    def obey(self, lifecycle: Lifecycle) -> None:
        lifecycle.saw(self.state)
        while (transition := lifecycle.next()) is not None:
            self.change(transition)
            lifecycle.ended(transition, self.state)


@given(
    st.sampled_from(STATES),
    st.booleans(),
    st.sampled_from(["deactivate", "cleanup", "leave"]),
    st.integers(min_value=1, max_value=3),
)
def test_a_node_is_active_while_wanted_and_then_as_it_was_found(
    found: str, keep: bool, afterwards: str, rounds: int
) -> None:
    node, lifecycle = Node(found), Lifecycle()
    for _ in range(rounds):
        before = node.state
        lifecycle.want(keep=keep, afterwards=afterwards)
        node.obey(lifecycle)
        assert node.state == "active"
        assert lifecycle.health() is Health.OK
        lifecycle.release()
        node.obey(lifecycle)
        if before == "active" or afterwards == "leave":
            assert node.state == "active"
        elif before == "unconfigured" and afterwards == "cleanup":
            assert node.state == "unconfigured"
        else:
            assert node.state == "inactive"


def test_a_change_by_another_client_is_not_undone() -> None:
    node, lifecycle = Node("inactive"), Lifecycle()
    lifecycle.want(keep=False, afterwards="deactivate")
    node.obey(lifecycle)
    node.state = "inactive"
    node.obey(lifecycle)
    assert (node.state, lifecycle.health()) == ("inactive", Health.DEGRADED)
    assert lifecycle.why_not == "not asked for here"
    node.state = "active"
    node.obey(lifecycle)
    assert lifecycle.health() is Health.OK
    lifecycle.release()
    node.obey(lifecycle)
    assert node.asked == [ACTIVATE]


def test_what_is_kept_active_is_activated_again_unless_it_failed() -> None:
    node, lifecycle = Node("unconfigured"), Lifecycle()
    lifecycle.want(keep=True, afterwards="deactivate")
    node.obey(lifecycle)
    node.state = "inactive"
    node.obey(lifecycle)
    assert node.asked == [CONFIGURE, ACTIVATE, ACTIVATE]
    node.state = "unconfigured"
    node.obey(lifecycle)
    assert (node.state, lifecycle.health()) == ("unconfigured", Health.LOST)


def test_a_failed_transition_is_repeated_only_for_a_new_component() -> None:
    lifecycle = Lifecycle()
    lifecycle.want(keep=True, afterwards="cleanup")
    lifecycle.saw("inactive")
    lifecycle.ended(ACTIVATE, "inactive")
    assert lifecycle.next() is None
    assert lifecycle.why_not == "activate failed"
    lifecycle.saw("inactive")
    assert lifecycle.next() is None
    lifecycle.want(keep=True, afterwards="cleanup")
    assert lifecycle.next() is ACTIVATE
    lifecycle.release()
    assert lifecycle.next() is None


@given(st.lists(st.sampled_from([*STATES, "activating", "errorprocessing", "finalized", "else"])))
def test_no_request_misfits_the_last_reported_state(states: list[str]) -> None:
    lifecycle = Lifecycle()
    lifecycle.want(keep=True, afterwards="cleanup")
    for state in states:
        lifecycle.saw(state)
        transition = lifecycle.next()
        assert transition is None or GOAL[transition][0] == state
