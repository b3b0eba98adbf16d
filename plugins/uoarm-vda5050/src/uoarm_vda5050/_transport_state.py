"""What becomes of the transport orders of one vehicle: no clock, no socket, no thread.

Events come in with the time: a goal, a cancellation, a state of the vehicle, the news that it came
or went, the passing of time. What is to be done comes out: messages to send, and news for the
client that asked. Times are seconds of one clock.

A message of QoS 0 may be lost on either side, so an order counts as taken only when a state says
so, and is sent again until then; the vehicle ignores the same order twice. A goal ends when a state
says how, and as `lost` when the vehicle is gone. An order whose goal has ended while the vehicle
may still have it is abandoned: seen again, it is cancelled, so that nothing is carried out that
no client waits for any more.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum
from typing import Any

from attrs import define, field, frozen

from uoarm.errors import BridgeError, FailureReason
from uoarm_vda5050._orders import (
    Body,
    Order,
    OrderReport,
    cancel_order,
    new_id,
    state_request,
    words_of,
)
from uoarm_vda5050._releases import VdaRelease

_MOST_ABANDONED = 64


@frozen
class Times:
    """Limits in seconds.

    Attributes:
        repeat: after which a message that was not answered is sent again.
        accept: within which a vehicle takes an order.
        settle: within which it says what became of the actions of an order that is over.
    """

    repeat: float = 2.0
    accept: float = 15.0
    settle: float = 10.0


@frozen
class Send:
    """A message for the vehicle: topic and body."""

    topic: str
    body: Body


@frozen
class Status:
    """A goal has begun or ended."""

    goal_id: str
    status: str


@frozen
class Feedback:
    """A state of the vehicle that has a goal."""

    goal_id: str
    feedback: Body


@frozen
class GoalEnded:
    """A goal has ended; `Status` follows."""

    goal_id: str
    status: str
    result: Body


Action = Send | Status | Feedback | GoalEnded


class Phase(Enum):
    """Where the goal is."""

    NONE = "no goal"
    ASKING = "nothing is known of the vehicle's order yet"
    SENT = "no state shows the order yet"
    UNDER_WAY = "a state has shown the order"


@define
class TransportState:
    """The goal of one vehicle, at most one at a time.

    Attributes:
        max_nodes: of one order.
        name: what the identifiers that it makes begin with; no other's do.
    """

    release: VdaRelease
    times: Times = Times()
    max_nodes: int = 1000
    name: str = field(factory=new_id)
    phase: Phase = Phase.NONE
    _order: Order | None = None
    _update: Order | None = None  # sent, and not seen in a state yet
    _ended: Order | None = None  # that of the last goal that has ended
    _known: OrderReport | None = None  # the last state of this connection of the vehicle
    _online: bool = True
    _repeat_at: float = 0.0
    _give_up_at: float = 0.0
    _settle_at: float | None = None
    _old_errors: tuple[Body, ...] = ()
    _cancel_id: str = ""
    _cancel_at: float | None = None  # None: the vehicle has it
    _abandoned: dict[str, str] = field(factory=dict)  # order to the action that cancels it
    _abandoned_at: float = 0.0
    _made: int = 0
    _unread: int = 0  # states that could not be read, since the last that could
    _why_unread: str = ""

    @property
    def goal_id(self) -> str:
        """The order of the goal that is under way, empty where none is."""
        return self._order.order_id if self._order is not None else ""

    def wake_at(self) -> float | None:
        """Return when `tick` is due, None for never."""
        times = []
        if self.phase in {Phase.ASKING, Phase.SENT}:
            times += [self._repeat_at, self._give_up_at]
        elif self._update is not None:
            times.append(self._repeat_at)
        if self._cancel_id and self._cancel_at is not None:
            times.append(self._cancel_at)
        if self._settle_at is not None:
            times.append(self._settle_at)
        return min(times) if times else None

    def goal(self, goal: Mapping[str, Any], now: float) -> tuple[str, list[Action]]:
        """Take a goal; return its identifier, and what is to be done.

        The goal that is under way, again, is followed and not sent again. With other nodes it is an
        update.

        Where the vehicle has another order under way, it ends as rejected.

        Raises:
            MessageError: it can be no order, or no update of the one under way.
            BridgeError: the vehicle is not connected; or the message before was not taken yet.
        """
        order_id = goal.get("orderId") or self._new_id()
        if self._order is not None:
            return order_id, self._goal_meanwhile(goal, order_id, now)
        order = Order.of(goal, order_id, self.release, self.max_nodes)
        if not self._online:
            text = "the vehicle is not connected"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        known = self._known
        if known is not None and known.order_id != order_id and known.is_busy_with(self._ended):
            which = "is being cancelled" if known.order_id in self._abandoned else "is under way"
            return order_id, _ended(order_id, "rejected", f"order {known.order_id!r} {which}")
        self._order, self._give_up_at = order, now + self.times.accept
        if known is None:
            self.phase, self._repeat_at = Phase.ASKING, now + self.times.repeat
            return order_id, [Send("instantActions", state_request(self.release, self._new_id()))]
        return order_id, self._begin(known, now)

    def cancel(self, goal_id: str, now: float) -> list[Action]:
        """Ask the vehicle to cancel the goal under way; nothing happens where it is another."""
        order = self._order
        if order is None or goal_id not in {"", order.order_id} or self._cancel_id:
            return []
        if self.phase is Phase.ASKING:  # it was never sent
            return self._end("canceled", "cancelled before it was sent")
        self._cancel_id, self._cancel_at = self._new_id(), now + self.times.repeat
        return [self._cancelling(self._cancel_id, order.order_id)]

    def state(self, body: Mapping[str, Any], now: float) -> list[Action]:
        """Take a state of the vehicle."""
        known = self._known = OrderReport.of(body, self.release)
        self._unread = 0
        actions = self._cancel_abandoned(known, now)
        if self.phase is Phase.ASKING:
            if known.order_id != self.goal_id and known.is_busy_with(self._ended):
                return [*actions, *self._end("rejected", f"order {known.order_id!r} is under way")]
            return [*actions, *self._begin(known, now)]
        if self.phase is Phase.SENT:
            return [*actions, *self._awaiting(known, now)]
        if self.phase is Phase.UNDER_WAY:
            return [*actions, *self._following(known, now)]
        return actions

    def unreadable(self, why: str) -> None:
        """Take the news that a state came that cannot be read: it is what silence comes from."""
        self._unread += 1
        self._why_unread = why

    def unread_states(self) -> str:
        """Say what came and could not be read, for the end of a sentence."""
        if not self._unread:
            return ""
        count = "a state came" if self._unread == 1 else f"{self._unread:,} states came"
        return f"; {count} that cannot be read: {self._why_unread}"

    def unsendable(self, why: str) -> list[Action]:
        """Take the news that the order cannot be sent at all, as one that is too large cannot."""
        return self._end("rejected", why) if self._order is not None else []

    def connection(self, online: bool, why: str) -> list[Action]:  # noqa: FBT001
        """Take the news that the vehicle came or went; what it did before is not known any more."""
        self._online, self._known, self._unread = online, None, 0
        if not online and self._order is not None:
            return self._end("lost", why)
        return []

    def tick(self, now: float) -> list[Action]:
        """Let time pass."""
        order = self._order
        if order is None:
            return []
        if self.phase in {Phase.ASKING, Phase.SENT} and now >= self._give_up_at:
            what = "said nothing of its state" if self.phase is Phase.ASKING else "did not take it"
            if self._unread and self.phase is Phase.ASKING:
                what = "sent no state that can be read"
            text = f"the vehicle {what} within {self.times.accept:g} s"
            return self._end("aborted", text + self.unread_states())
        if self._settle_at is not None and now >= self._settle_at:
            known = self._known
            silent = [
                action for action in order.actions if known is None or not known.status_of(action)
            ]
            text = f"the vehicle does not say what became of {', '.join(silent)}"
            return self._end("aborted", text + self.unread_states())
        actions: list[Action] = []
        if self._cancel_id and self._cancel_at is not None and now >= self._cancel_at:
            self._cancel_at = now + self.times.repeat
            actions.append(self._cancelling(self._cancel_id, order.order_id))
        if now >= self._repeat_at:
            self._repeat_at = now + self.times.repeat
            if self.phase is Phase.ASKING:
                actions.append(Send("instantActions", state_request(self.release, self._new_id())))
            elif self.phase is Phase.SENT and not self._cancel_id:
                actions.append(Send("order", order.body))
            elif self._update is not None and not self._cancel_id:
                actions.append(Send("order", self._update.body))
        return actions

    def _goal_meanwhile(self, goal: Mapping[str, Any], order_id: str, now: float) -> list[Action]:
        order = self._order
        assert order is not None, "there is a goal under way"
        if order_id != order.order_id:
            which = "is being cancelled" if self._cancel_id else "is under way"
            why = f"order {order.order_id!r} {which}{self.unread_states()}"
            return _ended(order_id, "rejected", why)
        latest = self._update or order
        if dict(goal) == dict(latest.goal):
            return [Status(order_id, "accepted")] if self.phase is Phase.UNDER_WAY else []
        if self._cancel_id:
            raise BridgeError(f"order {order_id!r} is being cancelled", FailureReason.REFUSED)
        if self._update is not None or self.phase is not Phase.UNDER_WAY:
            text = f"order {order_id!r}: the message before was not taken yet"
            raise BridgeError(text, FailureReason.REFUSED)
        self._update = order.extended(goal, self.release, self.max_nodes)
        self._repeat_at = now + self.times.repeat
        self._old_errors = () if self._known is None else self._known.errors
        return [Send("order", self._update.body)]

    def _begin(self, known: OrderReport, now: float) -> list[Action]:
        """Send the order, or follow it where the vehicle has it or has done it."""
        order = self._order
        assert order is not None, "there is a goal"
        self._abandoned.pop(order.order_id, None)
        if known.order_id == order.order_id:
            return self._accepted(known, now)
        self.phase, self._old_errors = Phase.SENT, known.errors
        self._repeat_at = now + self.times.repeat
        return [Send("order", order.body)]

    def _accepted(self, known: OrderReport, now: float) -> list[Action]:
        self.phase = Phase.UNDER_WAY
        return [Status(self.goal_id, "accepted"), *self._following(known, now)]

    def _awaiting(self, known: OrderReport, now: float) -> list[Action]:
        order = self._order
        assert order is not None, "there is a goal"
        if known.order_id == order.order_id:
            return self._accepted(known, now)
        if self._cancel_id and known.instants.get(self._cancel_id) in {"FINISHED", "FAILED"}:
            return self._end("canceled", "cancelled before the vehicle took it")
        refusals = self._refusals(known, order)
        if refusals:
            return self._end("rejected", _error_texts(refusals))
        return []

    def _following(self, known: OrderReport, now: float) -> list[Action]:
        order = self._order
        assert order is not None, "there is a goal"
        if known.order_id != order.order_id:
            what = f"order {known.order_id!r}" if known.order_id else "no order any more"
            return self._end("aborted", f"the vehicle now has {what}")
        if self._update is not None:
            if known.update_id >= self._update.update_id:
                order = self._order = self._update
                self._update = None
            elif self._refusals(known, self._update):
                self._update = None  # the order goes on as it was: the errors are in the feedback
        reports: list[Action] = [Feedback(order.order_id, known.feedback(order))]
        return [*reports, *self._ended_by(known, order, now)]

    def _ended_by(self, known: OrderReport, order: Order, now: float) -> list[Action]:
        cancelled = known.instants.get(self._cancel_id, "") if self._cancel_id else ""
        if cancelled:
            self._cancel_at = None
        waiting = self._settle_at
        self._settle_at = None
        if known.is_active or self._update is not None:
            if cancelled == "FINISHED":
                return self._end("canceled", "cancelled")
            if cancelled == "FAILED":
                self._cancel_id = ""  # it goes on; it may be asked again
            return []
        if cancelled not in {"", "FINISHED", "FAILED"}:
            return []
        is_cancelled = cancelled == "FINISHED"
        if any(known.is_under_way(action) for action in order.actions) and not is_cancelled:
            return []
        unsaid = [action for action in order.actions if not known.status_of(action)]
        if unsaid and not is_cancelled:
            self._settle_at = now + self.times.settle if waiting is None else waiting
            return []
        failed = [action for action in order.actions if known.status_of(action) == "FAILED"]
        # An order of this name may be one of before, over other nodes.
        is_there = (known.last_node, known.last_sequence) == order.steps[-1][:2]
        if is_there and not failed and not unsaid:
            return self._end("succeeded", "")
        if is_cancelled:
            return self._end("canceled", "cancelled")
        if failed:
            return self._end("aborted", f"failed: {', '.join(failed)}")
        return self._end("aborted", f"it ended at node {known.last_node!r}, before its last one")

    def _refusals(self, known: OrderReport, order: Order) -> list[Body]:
        """Return errors that refuse this message of the order, and no other one."""
        types = self.release.errors.refusals
        found = [error for error in known.errors if error["errorType"] in types]
        return [item for item in found if _is_about(item, order, self._old_errors)]

    def _end(self, status: str, reason: str) -> list[Action]:
        order, known = self._order, self._known
        assert order is not None, "there is a goal"
        shown = known if known is not None and known.order_id == order.order_id else None
        was_sent = self.phase in {Phase.SENT, Phase.UNDER_WAY}
        # One that no state has shown may come yet, behind what cancelled it, or an error that was
        # taken for its refusal.
        is_open = shown is None or (shown.is_busy_with(order) and status in {"lost", "aborted"})
        if was_sent and is_open:
            self._abandon(order.order_id)
        self.phase, self._order, self._update, self._ended = Phase.NONE, None, None, order
        self._cancel_id, self._settle_at, self._old_errors = "", None, ()
        return _ended(
            order.order_id,
            status,
            reason,
            last_node=known.last_node if known is not None else "",
            actions=shown.actions_of(order) if shown is not None else (),
            errors=known.errors if known is not None else (),
        )

    def _abandon(self, order_id: str) -> None:
        self._abandoned[order_id] = self._new_id()
        while len(self._abandoned) > _MOST_ABANDONED:
            self._abandoned.pop(next(iter(self._abandoned)))

    def _cancel_abandoned(self, known: OrderReport, now: float) -> list[Action]:
        action_id = self._abandoned.get(known.order_id)
        if action_id is None or known.order_id == self.goal_id:
            return []
        if not known.is_busy_with(self._ended):
            del self._abandoned[known.order_id]
            return []
        status = known.instants.get(action_id)
        if status in {"WAITING", "INITIALIZING", "RUNNING"} or now < self._abandoned_at:
            return []
        if status is not None:  # it has ended, and the vehicle does nothing for an action twice
            action_id = self._abandoned[known.order_id] = self._new_id()
        self._abandoned_at = now + self.times.repeat
        return [self._cancelling(action_id, known.order_id)]

    def _new_id(self) -> str:
        self._made += 1
        return f"{self.name}-{self._made}"

    def _cancelling(self, action_id: str, order_id: str) -> Send:
        return Send("instantActions", cancel_order(self.release, action_id, order_id))


def _ended(
    order_id: str,
    status: str,
    reason: str,
    *,
    last_node: str = "",
    actions: Iterable[Body] = (),
    errors: Iterable[Body] = (),
) -> list[Action]:
    result: Body = {
        "orderId": order_id,
        "lastNodeId": last_node,
        "reason": reason,
        "actions": list(actions),
        "errors": [dict(error) for error in errors],
    }
    return [GoalEnded(order_id, status, result), Status(order_id, status)]


def _is_about(error: Body, order: Order, old: tuple[Body, ...]) -> bool:
    """Say whether an error is about an order; what names none is, where it is new."""
    said = {
        reference["referenceKey"]: reference["referenceValue"]
        for reference in error.get("errorReferences", ())
    }
    if "orderId" not in said:
        return error not in old and said.get("topic", "order") == "order"
    update = str(said.get("orderUpdateId", order.update_id))
    return said["orderId"] == order.order_id and update == str(order.update_id)


def _error_texts(errors: list[Body]) -> str:
    return "the vehicle refuses it: " + "; ".join(map(words_of, errors))[:1000]
