"""Who comes along with a connection that returns, where several are about to move at once.

The states here are made by hand: two that move and share an input, each by a cause of its own, are
rare.
"""

from __future__ import annotations

import pytest
from attrs import evolve
from tests.control.test_transcripts import Player

from uoarm._control.engine.move import Move, MovePhase, MoveReason
from uoarm._control.engine.state import Switchover
from uoarm._support.ordered import OrderedMap
from uoarm.model import FailoverPolicy

OTHER = 99


def test_who_is_about_to_return_comes_along() -> None:
    player = _returning(is_switching=False, is_reconfiguration=False)
    (group,) = player.state.switchovers.values()
    assert set(group.members) == {"c1", "c2"}


@pytest.mark.parametrize(
    ("is_switching", "is_reconfiguration"), [(True, False), (False, True), (True, True)]
)
def test_whose_inputs_change_hands_or_who_is_reconfigured_is_left_alone(
    is_switching: bool, is_reconfiguration: bool
) -> None:
    player = _returning(is_switching=is_switching, is_reconfiguration=is_reconfiguration)
    other = player.state.switchovers[OTHER]
    (mine,) = (group for number, group in player.state.switchovers.items() if number != OTHER)
    assert (set(mine.members), set(other.members)) == ({"c1"}, {"c2"})


def _returning(*, is_switching: bool, is_reconfiguration: bool) -> Player:
    """Return a world in which c1 found its better plan, and feeds an input that c2 is to leave."""
    player = Player("face", FailoverPolicy(return_after=0.0))
    for move in ("request c1 face known", "do request c1", "die best", "do c1#2", "do c1#2"):
        player.play(move)
    for move in ("do c1#2>", "request c2 face", "do request c2", "do request c2", "revive best"):
        player.play(move)
    player.play("time 0.05")
    player.play("do c1?")
    state = player.state
    other = Switchover(
        OTHER,
        OrderedMap([("c2", None)]),
        OrderedMap([("c2", None)]),
        player.now,
        reason=MoveReason.CONFIGURATION if is_reconfiguration else MoveReason.RETURN,
        is_switching=is_switching,
    )
    phase = MovePhase.SWITCHING if is_switching else MovePhase.SEEKING
    second = state.connections["c2"]
    following = second.current if is_switching else None
    moved = second._replace(move=Move(other.reason, phase, player.now, "", following, OTHER))
    player.state = evolve(
        state,
        switchovers=state.switchovers.insert(OTHER, other),
        connections=state.connections.insert("c2", moved),
    )
    player.play("do switchover")
    return player
