"""Which goals wait, run and end: without ROS, by a clock of the test's own."""

from __future__ import annotations

from typing import Any, cast

import pytest
from uoarm_ros2._middleware import GoalRequest, GoalServer
from uoarm_ros2._offered_actions import GoalTable


class Clients:
    """Writes down what clients are answered."""

    def __init__(self) -> None:
        self.answers: list[tuple[Any, ...]] = []

    def accept(self, request: GoalRequest) -> None:
        self.answers.append(("accepted", request.id))

    def reject(self, request: GoalRequest) -> None:
        self.answers.append(("rejected", request.id))

    def feed(self, goal_id: bytes, feedback: Any) -> None:
        self.answers.append(("fed", goal_id, feedback))

    def end(self, goal_id: bytes, status: str, result: Any = None) -> None:
        self.answers.append((status, goal_id, result))


class Play:
    def __init__(self) -> None:
        self.now = 0.0
        self.clients = Clients()
        self.table = GoalTable(cast("GoalServer", self.clients), lambda: self.now)
        self.table.takes_goals = self.table.gives_results = True

    def ask(self, *names: bytes) -> None:
        for name in names:
            self.table.ask(GoalRequest(name, None, None, None), name)

    def next(self) -> Any:
        found = self.table.next()
        return None if found is None else found.message

    def status(self, name: str, status: str) -> None:
        self.table.receive_status({"goal_id": name, "status": status})

    def feed(self, name: str, what: object) -> None:
        self.table.receive_feedback({"goal_id": name}, what)

    def result(self, name: str, status: str, what: object) -> None:
        self.table.receive_result({"goal_id": name, "status": status}, what)

    def answers(self) -> list[tuple[Any, ...]]:
        answers, self.clients.answers = self.clients.answers, []
        return answers

    def run(self, request: bytes, name: str) -> None:
        self.ask(request)
        assert self.next() == request
        self.status(name, "accepted")
        assert self.answers() == [("accepted", request)]


@pytest.fixture
def play() -> Play:
    return Play()


def test_goals_are_handed_over_one_at_a_time_in_their_order(play: Play) -> None:
    play.ask(b"a", b"b", b"c")
    assert (play.next(), play.next()) == (b"a", None)
    play.status("1", "accepted")
    assert (play.next(), play.next()) == (b"b", None)
    play.status("2", "rejected")
    assert play.next() == b"c"
    assert play.answers() == [("accepted", b"a"), ("rejected", b"b")]


def test_what_comes_before_the_answer_waits_for_it_and_what_is_of_others_is_left(
    play: Play,
) -> None:
    play.ask(b"a")
    play.next()
    play.feed("1", "early")
    play.feed("other", "not ours")
    play.result("1", "succeeded", "done")
    play.status("1", "succeeded")
    assert play.answers() == []
    play.status("1", "accepted")
    assert play.answers() == [
        ("accepted", b"a"),
        ("fed", b"a", "early"),
        ("succeeded", b"a", "done"),
    ]
    play.feed("1", "late")
    play.result("other", "succeeded", "not ours")
    assert play.answers() == []


def test_an_unanswered_goal_is_rejected_and_the_next_has_its_turn(play: Play) -> None:
    play.ask(b"a", b"b")
    play.next()
    play.now = 9.9
    play.table.tick()
    assert (play.answers(), play.next()) == ([], None)
    play.now = 10.0
    play.table.tick()
    assert play.answers() == [("rejected", b"a")]
    assert play.next() == b"b"


def test_a_goal_that_ends_without_a_result_ends_all_the_same(play: Play) -> None:
    play.run(b"a", "1")
    play.status("1", "canceled")
    play.table.tick()
    assert play.answers() == []
    play.now = 2.0
    play.table.tick()
    assert play.answers() == [("canceled", b"a", None)]
    play.table.gives_results = False
    play.run(b"b", "2")
    play.status("2", "succeeded")
    assert play.answers() == [("succeeded", b"b", None)]


def test_a_result_that_is_none_of_its_type_and_a_goal_that_is_lost_are_aborted(play: Play) -> None:
    play.run(b"a", "1")
    play.result("1", "succeeded", None)
    assert play.answers() == [("aborted", b"a", None)]
    play.run(b"b", "2")
    play.status("2", "lost")
    assert play.answers() == [("aborted", b"b", None)]
    play.ask(b"c")
    play.next()
    play.status("", "lost")
    assert play.answers() == [("rejected", b"c")]


def test_when_the_offer_goes_every_goal_is_answered_and_ends(play: Play) -> None:
    play.run(b"a", "1")
    play.ask(b"b", b"c")
    play.next()
    play.table.takes_goals = False
    play.table.end_all()
    assert play.answers() == [("rejected", b"b"), ("rejected", b"c"), ("aborted", b"a", None)]
    play.ask(b"d")
    assert play.answers() == [("rejected", b"d")]
    assert play.next() is None
    assert play.table.facts() == {
        "waiting": 0,
        "running": 0,
        "accepted": 1,
        "rejected": 3,
        "ended": 1,
    }


def test_goals_are_bounded_and_an_id_is_one_goal(play: Play) -> None:
    play.ask(b"a", b"a")
    assert play.answers() == [("rejected", b"a")]
    play.ask(*(bytes([n]) for n in range(200)), *(bytes([n, 1]) for n in range(60)))
    assert play.table.facts()["waiting"] == 256
    assert len(play.answers()) == 5
