"""Wrong tokens are answered ever more slowly; right ones at once, from the same address too."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest
from tests.server.conftest import Serve
from tests.server.talk import Talk

from uoarm.server import Limits, Server, hash_token
from uoarm.server.access import WrongTokens
from uoarm.testing import ManualClock, patience

LONGEST = 2.5


def pauses(policy: WrongTokens, clock: ManualClock, address: str, count: int) -> list[float]:
    """Show a wrong token again and again, each as soon as the one before was answered."""
    found = []
    for _ in range(count):
        pause = policy.begin(address, clock())
        assert pause is not None
        clock.advance(pause)
        policy.end(address)
        found.append(pause)
    return found


def test_the_pause_doubles_up_to_the_longest() -> None:
    found = pauses(WrongTokens(LONGEST), ManualClock(), "10.0.0.1", 20)
    assert found[:5] == [0.0] * 5
    assert found[5:] == sorted(found[5:])
    assert found[-1] == LONGEST


def test_in_the_long_run_an_address_gets_an_answer_in_the_longest_pause() -> None:
    assert sum(pauses(WrongTokens(LONGEST), ManualClock(), "10.0.0.1", 1000)) > 980 * LONGEST


def test_a_few_mistakes_are_forgiven_after_a_while() -> None:
    policy, clock = WrongTokens(LONGEST), ManualClock()
    assert pauses(policy, clock, "10.0.0.1", 8)[-1] > 0
    clock.advance(120)
    assert pauses(policy, clock, "10.0.0.1", 5) == [0.0] * 5


def test_another_address_is_answered_at_once() -> None:
    policy, clock = WrongTokens(LONGEST), ManualClock()
    pauses(policy, clock, "10.0.0.1", 20)
    assert pauses(policy, clock, "10.0.0.2", 1) == [0.0]


def test_many_addresses_are_slowed_down_together() -> None:
    policy, clock = WrongTokens(LONGEST), ManualClock()
    found = [pauses(policy, clock, f"10.0.{number}.1", 1)[0] for number in range(200)]
    assert found[0] == 0
    assert found[-1] == LONGEST


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("2001:db8::1", "2001:db8::ffff:1"),
        ("::ffff:10.0.0.1", "10.0.0.1"),
        ("fe80::1%eth0", "fe80::2"),
    ],
)
def test_addresses_that_one_client_may_have_are_one(one: str, other: str) -> None:
    policy, clock = WrongTokens(LONGEST), ManualClock()
    pauses(policy, clock, one, 10)
    assert pauses(policy, clock, other, 1)[0] > 0


def test_few_wait_at_one_time_and_few_of_one_address() -> None:
    policy = WrongTokens(LONGEST, waiting=16)
    of_one = [policy.begin("10.0.0.1", 0) for _ in range(5)]
    assert [pause is None for pause in of_one] == [False, False, True, True, True]
    others = [policy.begin(f"10.0.1.{number}", 0) for number in range(20)]
    assert sum(pause is not None for pause in others) == 14
    policy.end("10.0.0.1")
    assert policy.begin("10.0.0.1", 0) is not None


def test_what_is_remembered_is_bounded() -> None:
    policy = WrongTokens(LONGEST)
    for number in range(10_000):
        address = f"10.{number >> 16}.{number >> 8 & 255}.{number & 255}"
        if policy.begin(address, 0) is not None:
            policy.end(address)
    assert len(policy._of) <= 4096


@pytest.fixture
def guarded(serve: Serve, tmp_path: Path) -> Server:
    access = tmp_path / "access.yaml"
    access.write_text(
        "version: 1\nroles: {all: {see: all, call: all}}\n"
        f"tokens: [{{name: t, role: all, sha256: {hash_token('right')}}}]\n",
        encoding="utf-8",
    )
    return serve(Limits(handshake_seconds=2 * patience()), access=access)


def test_a_right_token_is_let_in_while_wrong_ones_wait(guarded: Server) -> None:
    """From the same address, too: those that wait do so for a minute here."""
    port = guarded.ports[0]
    opened = []

    def show(token: str) -> socket.socket:
        made = socket.create_connection(("127.0.0.1", port), timeout=patience())
        made.sendall(
            f"GET /metrics?token={token} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode()
        )
        opened.append(made)
        return made

    try:
        for _ in range(5):
            assert b" 401 " in show("wrong").recv(4096)
        policy = guarded._admission.wrong_tokens
        while policy._waiting.total() == 0:
            show("wrong")
        with Talk(f"ws://127.0.0.1:{port}/?token=right") as client:
            assert client.ask("Call", "add", {"a": 1, "b": 2}) == {"value": 3}
        assert policy._waiting.total() > 0
    finally:
        for made in opened:
            made.close()
