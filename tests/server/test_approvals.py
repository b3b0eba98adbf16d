"""Approvals: given by another principal, for exact arguments, once, for a time; attacked."""

from __future__ import annotations

import itertools
import json
import logging
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

import pytest
from attrs import evolve
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from tests.disk import full_after
from tests.server.conftest import Serve
from tests.server.serving import access_file
from tests.server.talk import Talk

from uoarm.config import loads
from uoarm.errors import ConfigurationError, MessageError
from uoarm.server import make_token
from uoarm.server.access import AccessRole, Approvals, Operation, Supervision
from uoarm.server.access._access_file import read_access
from uoarm.server.access._approvals import (
    Approval,
    ApprovalBook,
    ApprovalEnvelope,
    ApprovalError,
    ApprovalFoundation,
    ApprovalPhase,
    ApprovalRequest,
    digest_of,
)
from uoarm.server.access._role import Audit, AuditFile, masked

FOUNDATION = ApprovalFoundation(1, ("cuff",))
REQUEST = ApprovalRequest("agent", "call", "cuff", "", {"pressure": 120.0}, FOUNDATION)


def approved(request: ApprovalRequest = REQUEST) -> ApprovalBook:
    book = ApprovalBook()
    book.ask("a", request, 0.0)
    book.decide("a", "nurse", 1.0, approve=True)
    return book


def phase(book: ApprovalBook, now: float) -> ApprovalPhase:
    found = book.find("a", now)
    assert found is not None
    return found.phase


def test_what_was_approved_is_done_once() -> None:
    book = approved()
    assert book.use("a", REQUEST, 2.0).phase is ApprovalPhase.USED
    with pytest.raises(ApprovalError, match="is used"):
        book.use("a", REQUEST, 2.0)


def test_nothing_is_done_before_it_is_approved() -> None:
    book = ApprovalBook()
    book.ask("a", REQUEST, 0.0)
    with pytest.raises(ApprovalError, match="is pending"):
        book.use("a", REQUEST, 1.0)
    book.decide("a", "nurse", 1.0, approve=False, cause="not now")
    with pytest.raises(ApprovalError, match="is refused: not now"):
        book.use("a", REQUEST, 1.0)


@pytest.mark.parametrize(
    ("wanted", "text"),
    [
        (evolve(REQUEST, arguments={"pressure": 121.0}), "other arguments"),
        (evolve(REQUEST, arguments={"pressure": 120}), "other arguments"),
        (evolve(REQUEST, arguments={"pressure": 120.0, "more": None}), "other arguments"),
        (evolve(REQUEST, function="drive"), "not of this"),
        (evolve(REQUEST, operation="send"), "not of this"),
        (evolve(REQUEST, port="other"), "not of this"),
        (evolve(REQUEST, requester="other"), "there is no approval"),
    ],
)
def test_nothing_else_is_done_with_it(wanted: ApprovalRequest, text: str) -> None:
    book = approved()
    with pytest.raises(ApprovalError, match=text):
        book.use("a", wanted, 2.0)
    assert phase(book, 2.0) is ApprovalPhase.APPROVED


@pytest.mark.parametrize(
    "foundation", [ApprovalFoundation(2, ("cuff",)), ApprovalFoundation(1, ("other",))]
)
def test_another_configuration_or_component_makes_it_void(foundation: ApprovalFoundation) -> None:
    book = approved()
    with pytest.raises(ApprovalError, match="is void"):
        book.use("a", evolve(REQUEST, foundation=foundation), 2.0)
    with pytest.raises(ApprovalError, match="is void"):
        book.use("a", REQUEST, 2.0)


@pytest.mark.parametrize(
    "arguments",
    [
        {"pressure": float("nan")},
        {"pressure": [1.0, float("-inf")]},
        {"at": datetime(2026, 1, 1, tzinfo=timezone.utc)},
        {"pressure": 2**70},
        {1: 2},
    ],
)
def test_what_is_not_shown_as_it_is_cannot_be_asked_for(arguments: Any) -> None:
    with pytest.raises(MessageError, match="plain JSON"):
        ApprovalBook().ask("a", evolve(REQUEST, arguments=arguments), 0.0)


def test_who_asks_does_not_approve() -> None:
    book = ApprovalBook()
    book.ask("a", REQUEST, 0.0)
    with pytest.raises(ApprovalError, match="another principal"):
        book.decide("a", "agent", 1.0, approve=True)
    assert phase(book, 1.0) is ApprovalPhase.PENDING


def test_a_decision_stands() -> None:
    book = approved()
    with pytest.raises(ApprovalError, match="is approved"):
        book.decide("a", "other", 2.0, approve=False)
    book.use("a", REQUEST, 2.0)
    with pytest.raises(ApprovalError, match="is used"):
        book.decide("a", "nurse", 3.0, approve=True)


def test_it_expires_before_and_after_the_decision() -> None:
    book = ApprovalBook()
    book.ask("a", REQUEST, 0.0)
    with pytest.raises(ApprovalError, match="is expired: no decision"):
        book.decide("a", "nurse", 900.0, approve=True)
    book = approved()
    with pytest.raises(ApprovalError, match="is expired: unused"):
        book.use("a", REQUEST, 61.0)


def test_an_envelope_has_ranges_a_count_and_a_rate() -> None:
    envelope = ApprovalEnvelope({"linear.x": (-0.2, 0.2)}, count=3, rate=2.0)
    base = evolve(REQUEST, arguments={"linear": {"x": 0.1, "y": 0.0}}, envelope=envelope)

    def at(x: object, y: float = 0.0) -> ApprovalRequest:
        return evolve(base, arguments={"linear": {"x": x, "y": y}})

    book = approved(base)
    for wrong in (at(0.3), at(float("nan")), at(0.1, 0.1), at("0.1"), at(True), at(None)):
        with pytest.raises(ApprovalError, match="other arguments"):
            book.use("a", wrong, 2.0)
    book.use("a", at(0.2), 2.0)
    with pytest.raises(ApprovalError, match="times a second"):
        book.use("a", at(0.2), 2.4)
    book.use("a", at(-0.2), 2.5)
    assert book.use("a", at(0), 3.0).phase is ApprovalPhase.USED


@pytest.mark.parametrize(
    "envelope",
    [
        ApprovalEnvelope({"pressure": (130.0, 140.0)}),
        ApprovalEnvelope({"pressure": (140.0, 100.0)}),
        ApprovalEnvelope({"pressure": (float("nan"), 140.0)}),
        ApprovalEnvelope({"other": (0.0, 1.0)}),
        ApprovalEnvelope(count=0),
        ApprovalEnvelope(rate=0.0),
        ApprovalEnvelope(rate=float("nan")),
        ApprovalEnvelope({f"f{number}": (0.0, 1.0) for number in range(65)}),
    ],
)
def test_an_envelope_that_says_nothing_certain_is_refused(envelope: ApprovalEnvelope) -> None:
    with pytest.raises(ApprovalError):
        ApprovalBook().ask("a", evolve(REQUEST, envelope=envelope), 0.0)


def test_what_can_be_asked_for_is_bounded() -> None:
    book = ApprovalBook()
    for number in range(32):
        book.ask(str(number), REQUEST, 0.0)
    with pytest.raises(ApprovalError, match="32 approvals"):
        book.ask("more", REQUEST, 0.0)
    book.ask("of another", evolve(REQUEST, requester="other"), 0.0)
    with pytest.raises(MessageError, match="at most"):
        ApprovalBook().ask("a", evolve(REQUEST, arguments="x" * 70_000), 0.0)
    for number in itertools.count(1):
        book.ask(f"n{number}", evolve(REQUEST, requester=f"p{number}"), 0.0)
        book.decide(f"n{number}", "nurse", 0.0, approve=False)
        if number == 1000:
            break
    assert len(book.all(0.0)) <= 33 + 256
    assert not book.all(10_000.0) or all(not item.is_open for item in book.all(10_000.0))
    assert not book.all(20_000.0)


@given(st.recursive(st.none() | st.booleans() | st.integers(-9, 9) | st.text(max_size=3),
                    lambda part: st.lists(part, max_size=3)
                    | st.dictionaries(st.text(max_size=3), part, max_size=3)))  # fmt: skip
def test_the_digest_is_of_the_value_and_not_of_the_order_of_names(value: Any) -> None:
    assert digest_of(value) == digest_of(_turned(value))


def _turned(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _turned(part) for name, part in reversed(value.items())}
    return [_turned(part) for part in value] if isinstance(value, list) else value


def test_every_order_of_steps_does_at_most_what_was_approved() -> None:
    """All orders of seven steps: what is done was approved by another one before, once, in time."""
    steps: dict[str, Callable[[ApprovalBook, float], object]] = {
        "approve": lambda book, now: book.decide("a", "nurse", now, approve=True),
        "by itself": lambda book, now: book.decide("a", "agent", now, approve=True),
        "refuse": lambda book, now: book.decide("a", "nurse", now, approve=False),
        "use": lambda book, now: book.use("a", REQUEST, now),
        "use again": lambda book, now: book.use("a", REQUEST, now),
        "configure": lambda book, now: book.void(lambda _: "another revision", now),
        "wait": lambda book, now: None,
    }
    for order in itertools.permutations(steps):
        book, now, done, allowed = ApprovalBook(), 0.0, 0, False
        book.ask("a", REQUEST, now)
        for step in order:
            now += 100.0 if step == "wait" else 0.1
            if step in {"wait", "configure"}:
                allowed = False if step == "configure" or allowed else allowed
            before = book.find("a", now)
            try:
                steps[step](book, now)
            except ApprovalError:
                assert book.find("a", now) == before, "what is refused changes nothing"
                continue
            if step == "approve":
                allowed = True
            elif step == "refuse":
                assert not allowed
            elif step.startswith("use"):
                done += 1
                assert allowed, order
                allowed = False
        assert done <= 1


class RandomApprovals(RuleBasedStateMachine):
    """Random use of a book of several approvals beside a plain model of it."""

    def __init__(self) -> None:
        super().__init__()
        self.book = ApprovalBook()
        self.now = 0.0
        self.names: list[str] = []
        self.may: dict[str, tuple[int, float]] = {}
        self.done: dict[str, int] = {}

    @rule(who=st.sampled_from("ab"), count=st.integers(1, 3))
    def ask(self, who: str, count: int) -> None:
        name = f"{who}{len(self.names)}"
        request = evolve(
            REQUEST, requester=who, envelope=ApprovalEnvelope(count=count), seconds=10.0
        )
        try:
            self.book.ask(name, request, self.now)
        except ApprovalError:
            assert len(self.names) >= 32
        else:
            self.names.append(name)

    @precondition(lambda self: self.names)
    @rule(data=st.data(), who=st.sampled_from("abn"), approve=st.booleans())
    def decide(self, data: st.DataObject, who: str, approve: bool) -> None:
        name = data.draw(st.sampled_from(self.names))
        try:
            decided = self.book.decide(name, who, self.now, approve=approve)
        except ApprovalError:
            return
        assert who != name[0]
        if approve:
            assert name not in self.may
            self.may[name] = decided.request.envelope.count, self.now + 10.0

    @precondition(lambda self: self.names)
    @rule(data=st.data(), who=st.sampled_from("ab"), value=st.sampled_from([120.0, 121.0]))
    def use(self, data: st.DataObject, who: str, value: float) -> None:
        name = data.draw(st.sampled_from(self.names))
        wanted = evolve(REQUEST, requester=who, arguments={"pressure": value})
        count, until = self.may.get(name, (0, 0.0))
        allowed = (
            who == name[0]
            and value == 120.0
            and self.done.get(name, 0) < count
            and self.now < until
        )
        try:
            self.book.use(name, wanted, self.now)
        except ApprovalError:
            assert not allowed
        else:
            assert allowed
            self.done[name] = self.done.get(name, 0) + 1

    @rule(seconds=st.floats(0.0, 6.0))
    def wait(self, seconds: float) -> None:
        self.now += seconds

    @rule()
    def reconfigure(self) -> None:
        self.book.void(lambda _: "another revision", self.now)
        self.may = dict.fromkeys(self.names, (0, 0.0))

    @invariant()
    def what_changed_is_reported_in_order(self) -> None:
        for approval in self.book.take_changes():
            known = self.book.find(approval.id, self.now)
            assert known is None or isinstance(known, Approval)


TestApprovals = RandomApprovals.TestCase
TestApprovals.settings = settings(max_examples=60, stateful_step_count=30, deadline=None)


@pytest.mark.parametrize(
    "envelope",
    [
        ApprovalEnvelope({"pressure": (0, 2**63)}),
        ApprovalEnvelope({"pressure": (-(10**30), 200)}),
        ApprovalEnvelope(rate=10**30),
    ],
)
def test_an_envelope_that_some_reader_of_json_cannot_read_is_refused(
    envelope: ApprovalEnvelope,
) -> None:
    with pytest.raises(ApprovalError, match=r"64 bits|times a second"):
        ApprovalBook().ask("a", evolve(REQUEST, envelope=envelope), 0.0)


def test_nothing_is_done_while_the_audit_log_cannot_be_written(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "log" / "audit.jsonl"
    path.parent.mkdir()
    kept = AuditFile(path)
    try:
        approvals = Approvals(Audit(), Supervision(lambda: loads(CONFIGURATION)))
        role = AccessRole("nurse", everything=frozenset({Operation.APPROVE}))
        first, second = (approvals.ask(REQUEST).id for _ in range(2))
        approvals.decide(first, "nurse", role, approve=True)
        approvals.decide(second, "nurse", role, approve=True)
        path.write_text(path.read_text("utf-8") + '{"half of', encoding="utf-8")  # a full disk
        path.parent.rename(tmp_path / "away")
        with pytest.raises(ApprovalError, match="audit log cannot be written"):
            approvals.use(first, REQUEST)
        assert f'it lacks the line {{"approval":"{first}","phase":"used"' in caplog.text
        (tmp_path / "away").rename(path.parent)
        assert approvals.use(second, REQUEST).phase is ApprovalPhase.USED
    finally:
        kept.close()
    *_, broken, last = path.read_text("utf-8").splitlines()
    assert broken == '{"half of'
    assert json.loads(last)["phase"] == "used"


def test_an_audit_log_on_a_full_disk_ends_as_any_other(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    kept = AuditFile(tmp_path / "audit.jsonl")
    with full_after((tmp_path / "audit.jsonl").stat().st_size):
        Audit().departure("a session")
        assert kept.is_failing
        kept.close()
    assert "File too large" in caplog.text


def test_half_a_character_of_a_client_is_in_the_log(caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "uoarm.audit")
    Audit().approval_denied("\ud800", "agent", "cuff", "there is none")
    Audit().approval({"phase": "pending"}, {"value": 10**30})
    lines = [json.loads(record.getMessage()) for record in caplog.records]
    assert lines[0]["approval"] == "\ud800"
    assert lines[1]["arguments"] == {"value": 10**30}


def test_secrets_and_octets_are_not_in_the_log() -> None:
    assert masked({"user": "a", "Password": "b", "deep": [{"api_key": "c", "pin": 1}]}) == {
        "user": "a",
        "Password": "***",
        "deep": [{"api_key": "***", "pin": "***"}],
    }
    assert masked({"data": b"123"}) == {"data": "3 octets"}


CONFIGURATION = """
version: 1
bridges: {python: {}}
functions:
  add:
    approve: true
    components:
      - {name: adder, bridge: python, service: {endpoint: ["tests.server.robot:add"]}}
  parrot:
    components:
      - name: parrot
        bridge: python
        service: {endpoint: ["tests.server.robot:parrot"], lifetime: 5}
  anything:
    components:
      - {name: anything, bridge: python, service: {endpoint: ["tests.server.robot:anything"]}}
  echo:
    components:
      - name: echo
        bridge: python
        input:
          endpoint: ["tests.server.robot:echo"]
          lifetime: 0.5
          stop: {message: {value: 0}}
        output: {endpoint: ["tests.server.robot:echo"]}
  numbers:
    components:
      - {name: numbers, bridge: python, output: {endpoint: ["tests.server.robot:numbers"]}}
  doubled:
    components:
      - name: doubled
        bridge: python
        input:
          from: numbers
          endpoint: ["tests.server.robot:double"]
          lifetime: 0.5
          stop: {message: {value: 0}}
        output: {endpoint: ["tests.server.robot:double"]}
  above:
    components:
      - name: above
        bridge: python
        input: {from: doubled, endpoint: ["tests.server.robot:double"]}
        output: {endpoint: ["tests.server.robot:double"]}
"""


def test_what_moves_needs_an_approval_also_where_opening_it_moves() -> None:
    robot = loads(CONFIGURATION)
    supervision = Supervision(lambda: robot)
    needing = {
        (operation.value, name)
        for operation in (Operation.CALL, Operation.SEND, Operation.REQUEST)
        for name in robot.functions
        if supervision.reason(operation, name)
    }
    assert needing == {
        ("call", "add"), ("send", "add"), ("request", "add"),
        ("call", "parrot"), ("send", "parrot"),
        ("call", "echo"), ("send", "echo"),
        ("call", "doubled"), ("send", "doubled"), ("request", "doubled"),
        ("call", "above"), ("send", "above"), ("request", "above"),
    }  # fmt: skip
    assert supervision.reason(Operation.REQUEST, "above") == (
        "above uses doubled: doubled moves something: its input 'default' has a lifetime"
    )


ACCESS = """
version: 1
roles:
  agent: {{see: all, request: ["*"], call: ["*"], send: ["*"], supervised: true}}
  nurse: {{see: all, approve: ["add"], call: ["*"]}}
  cook: {{see: all, approve: ["other*"]}}
tokens:
  - {{name: agent, role: agent, sha256: {agent}}}
  - {{name: tablet, principal: agent, role: nurse, sha256: {tablet}}}
  - {{name: nurse, role: nurse, sha256: {nurse}}}
  - {{name: cook, role: cook, sha256: {cook}}}
"""
TOKENS = {name: make_token() for name in ("agent", "tablet", "nurse", "cook")}


@pytest.fixture
def access(tmp_path: Path) -> Path:
    return access_file(tmp_path, ACCESS, TOKENS)


def test_a_supervised_role_goes_no_other_way(serve: Serve, access: Path, robot: Any) -> None:
    robot.apply(loads(CONFIGURATION))
    server = serve(access=access)
    with Talk(
        f"ws://127.0.0.1:{server.ports[0]}/",
        additional_headers={"Authorization": f"Bearer {TOKENS['agent']}"},
    ) as agent:
        for op, function, message in (
            ("Call", "add", {"a": 1, "b": 2}),
            ("Call", "parrot", {"text": "x"}),
            ("Request", "doubled", None),
            ("Request", "above", None),
        ):
            refusal = agent.refused(op, function, message)
            assert refusal["code"] == "denied"
            assert "needs an approval" in refusal["text"]
        assert agent.refused("Approve", "x", {"approve": True})["code"] == "denied"
    with Talk(
        f"ws://127.0.0.1:{server.ports[0]}/",
        additional_headers={"Authorization": f"Bearer {TOKENS['nurse']}"},
    ) as nurse:
        assert nurse.ask("Call", "add", {"a": 1, "b": 2}) == {"value": 3}
        assert nurse.ask("Approve") == {"approvals": []}
        assert nurse.refused("Approve", "x")["code"] == "usage"


def test_a_supervised_role_has_no_right_that_goes_round_it(tmp_path: Path) -> None:
    path = tmp_path / "access.yaml"
    path.write_text(
        "version: 1\nroles: {agent: {approve: ['*'], release: all, supervised: true}, "
        "other: {supervised: 1}}\ntokens: [{name: a, role: other, principal: 3, sha256: x}]\n",
        encoding="utf-8",
    )
    with pytest.raises(ConfigurationError) as wrong:
        read_access(path)
    text = str(wrong.value)
    assert "a supervised role has no approve" in text
    assert "a supervised role has no release" in text
    assert "expected true or false" in text
    assert "principal: expected text" in text


def test_each_step_is_in_the_audit_log_with_who_what_when_and_the_arguments(
    caplog: pytest.LogCaptureFixture,
) -> None:
    robot = loads(CONFIGURATION)
    role = AccessRole("nurse", {Operation.APPROVE: ("add",)})
    with caplog.at_level(logging.INFO, "uoarm.audit"):
        approvals = Approvals(Audit(), Supervision(lambda: robot))
        request = evolve(REQUEST, function="add", arguments={"a": 1, "password": "x"})
        identity = approvals.ask(request).id
        approvals.decide(identity, "nurse", role, approve=True)
        approvals.use(identity, request)
        with pytest.raises(ApprovalError):
            approvals.use(identity, request)
    lines = [json.loads(record.message) for record in caplog.records]
    assert [line.get("phase") for line in lines] == ["pending", "approved", "used", None]
    assert {line["requester"] for line in lines} == {"agent"}
    assert lines[1]["approver"] == "nurse"
    assert lines[1]["arguments"] == {"a": 1, "password": "***"}
    assert all(line["time"] > 0 for line in lines)
    assert "is used" in lines[3]["refused"]
