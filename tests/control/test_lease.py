"""Who may command an input: decided in every order of what two senders and the time can do."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable

import pytest

from uoarm._safety import InputLease, Lease
from uoarm.errors import CommandRefusedError
from uoarm.model import LeaseHolder, LeasePolicy
from uoarm.testing import patience

DURATION = 1.0
POLICY = LeasePolicy(DURATION, (("safety", 10.0), ("guest", -1.0)))
ALICE, BOB = LeaseHolder("alice"), LeaseHolder("bob")
SAFETY, GUEST = LeaseHolder("safety 1", "safety"), LeaseHolder("guest 1", "guest")


class Model:
    """What should be: who holds it and until when, written in another way than the lease is."""

    def __init__(self) -> None:
        self.lease = Lease(POLICY)
        self.now = 0.0
        self.holding: tuple[LeaseHolder, float] | None = None

    def holder(self) -> LeaseHolder | None:
        return self.holding[0] if self.holding and self.now < self.holding[1] else None

    def ask(self, sender: LeaseHolder, *, take_over: bool) -> None:
        holder = self.holder()
        rank = {"safety": 10, "guest": -1, "": 0}
        if holder in {None, sender}:
            has = True
        elif take_over:
            has = rank[sender.role] >= rank[holder.role]
        else:
            has = rank[sender.role] > rank[holder.role]
        refused = self.lease.ask(sender, self.now, take_over=take_over)
        assert bool(refused) is not has
        if has:
            self.holding = sender, self.now + DURATION
        else:
            assert str(holder) in refused, "the refusal names who has it"

    def give_back(self, sender: LeaseHolder) -> None:
        held = self.holder() == sender
        assert self.lease.give_back(sender, self.now) is held
        if held:
            self.holding = None

    def check(self) -> None:
        assert self.lease.holder(self.now) == self.holder()
        for lease_holder in (ALICE, BOB, SAFETY, GUEST):
            assert self.lease.passes(lease_holder, self.now) is (
                self.holder() in {None, lease_holder}
            )
        status = self.lease.status(self.now)
        assert status.holder == self.holder()
        assert 0 <= status.left <= DURATION


def asks(sender: LeaseHolder, *, take_over: bool) -> Callable[[Model], object]:
    return lambda model: model.ask(sender, take_over=take_over)


def passes(seconds: float) -> Callable[[Model], object]:
    return lambda model: setattr(model, "now", model.now + seconds)


STEPS: dict[str, Callable[[Model], object]] = {
    **{
        f"{lease_holder} sends": asks(lease_holder, take_over=False)
        for lease_holder in (ALICE, BOB, SAFETY, GUEST)
    },
    **{
        f"{lease_holder} takes over": asks(lease_holder, take_over=True)
        for lease_holder in (ALICE, BOB, SAFETY, GUEST)
    },
    "alice leaves": lambda model: model.give_back(ALICE),
    "safety leaves": lambda model: model.give_back(SAFETY),
    "time passes": passes(DURATION / 2),
    "time is over": passes(DURATION),
}


def test_every_order_of_four_steps_has_the_holder_that_it_should() -> None:
    for order in itertools.product(STEPS, repeat=4):
        model = Model()
        for step in order:
            STEPS[step](model)
            try:
                model.check()
            except AssertionError as error:
                raise AssertionError(f"after {step!r} of {order}") from error


def test_of_two_that_ask_at_once_one_has_it_and_the_other_learns_who() -> None:
    reports: list[str] = []
    lease = InputLease(POLICY, "base.default", reports.append, clock=lambda: 0.0)
    at_once, refused = threading.Barrier(8), []

    def ask(sender: LeaseHolder) -> None:
        at_once.wait(patience())
        try:
            lease.ask(sender)
        except CommandRefusedError as error:
            refused.append((error.reason, str(error)))

    threads = [threading.Thread(target=ask, args=(LeaseHolder(f"s{n}"),)) for n in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(patience())
    holder = lease.status().holder
    assert reports == [f"base.default: {holder} holds its lease"]
    text = f"base.default: {holder} holds its lease, for another 1.000 s without a command"
    assert refused == [("leased", f"{text} of its own")] * 7


def test_a_command_whose_sender_lost_the_lease_meanwhile_is_refused() -> None:
    lease = InputLease(POLICY, "base.default", lambda _: None, clock=lambda: 0.0)
    lease.ask(ALICE)
    lease.require(ALICE)
    lease.ask(BOB, take_over=True)
    with pytest.raises(CommandRefusedError, match="taken over while the command waited"):
        lease.require(ALICE)
