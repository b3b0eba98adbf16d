"""One goal of an action: what was asked, who hears of it, and that it ends once."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from typing import Protocol

from attrs import define, field

from uoarm.model import Message
from uoarm.server.front_end import Done

__all__ = ["Goal", "GoalStatus", "Runner"]


class GoalStatus(IntEnum):
    """How a goal stands, with the numbers of `action_msgs/msg/GoalStatus`."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6


@define(eq=False)
class Goal:
    """A goal on its way; everything in the loop's thread.

    After its end nothing more is heard of it, whatever still comes.

    Attributes:
        arguments: the goal as the client wrote it.
        on_feedback: hears what comes before the result.
        on_result: hears the result and how the goal ended.
        on_failure: hears why there is no result.
        octets: of memory that the arguments hold.
        kind: the type of the action that the client states; empty: none.
        ended: whether one of the two last was called, or the client has gone.
    """

    arguments: Message
    on_feedback: Callable[[Message], None]
    on_result: Callable[[Message, GoalStatus], None]
    on_failure: Callable[[BaseException], None]
    octets: int = 0
    kind: str = ""
    ended: bool = field(default=False, init=False)

    def feed(self, values: Message) -> None:
        """Pass feedback on."""
        if not self.ended:
            self.on_feedback(values)

    def finish(self, values: Message, status: GoalStatus) -> None:
        """Pass the result on."""
        if not self.ended:
            self.ended = True
            self.on_result(values, status)

    def fail(self, error: BaseException) -> None:
        """Tell that there is no result."""
        if not self.ended:
            self.ended = True
            self.on_failure(error)


class Runner(Protocol):
    """Who works on the goals of one action."""

    def start(self, goal: Goal) -> None:
        """Begin with a goal; raises UoarmError when it is refused at once."""

    def cancel(self, goal: Goal, done: Done) -> None:
        """Ask for a goal's end; raises UoarmError where that cannot be asked.

        What the goal ends with comes as its result; `done` hears how the asking went.
        """

    def abandon(self, goal: Goal) -> None:
        """Cancel, as far as it can be, a goal whose client has gone."""
