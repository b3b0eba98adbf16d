"""Who is let in and what each may do: deny by default, seen from outside."""

from __future__ import annotations

import json
import logging
import os
import ssl
import threading
from collections.abc import Callable
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.server.conftest import Serve
from tests.server.serving import access_file, url
from tests.server.talk import SECONDS, Talk, eventually
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus
from websockets.typing import Origin, Subprotocol

from uoarm import RobotManager
from uoarm._support.certificates import Authority
from uoarm.errors import ConfigurationError
from uoarm.model import StatusEvent
from uoarm.server import Server, hash_token, make_token
from uoarm.server.access import Admission, Credentials, RequestHead
from uoarm.server.access._access_file import BUDGET, read_access
from uoarm.server.access._role import AccessPolicy, AccessRole, Grant, Operation

Write = Callable[..., Path]
JSON = Subprotocol("uoarm.v1.json")

ACCESS = """
version: 1
roles:
  viewer: {{see: all, request: ["num*"]}}
  driver: {{see: ["echo"], request: ["echo"], send: ["echo"], call: ["add"]}}
  operator: {{see: all, kill: ["numbers"]}}
  rightless: {{}}
  guesser: {{see: ["echo"], request: ["*"], send: ["*"], call: ["*"], kill: ["*"]}}
tokens:
  - {{name: screen, role: viewer, sha256: {viewer}}}
  - {{name: pad, role: driver, sha256: {driver}}}
  - {{name: desk, role: operator, sha256: {operator}}}
  - {{name: dummy, role: rightless, sha256: {rightless}}}
  - {{name: guess, role: guesser, sha256: {guesser}}}
  - {{name: old, role: viewer, sha256: {old}, expires: 2020-01-01T00:00:00Z}}
"""
ROLES = ("viewer", "driver", "operator", "rightless", "guesser", "old")
TOKENS = {name: make_token() for name in ROLES}


@pytest.fixture
def access(tmp_path: Path) -> Path:
    return access_file(tmp_path, ACCESS, TOKENS)


@pytest.fixture
def guarded(serve: Serve, access: Path) -> Server:
    return serve(access=access)


def enter(server: Server, name: str) -> Talk:
    return Talk(url(server), additional_headers={"Authorization": f"Bearer {TOKENS[name]}"})


def status_of(action: Callable[[], object]) -> int:
    with pytest.raises(InvalidStatus) as refused:
        action()
    return refused.value.response.status_code


def test_without_a_token_no_client_is_admitted(guarded: Server) -> None:
    assert status_of(lambda: Talk(url(guarded))) == 401
    headers = {"Authorization": f"Bearer {make_token()}"}
    assert status_of(lambda: Talk(url(guarded), additional_headers=headers)) == 401
    assert status_of(lambda: Talk(url(guarded, "/?token=guess"))) == 401
    assert status_of(lambda: enter(guarded, "old")) == 401


def test_a_refusal_names_its_code(guarded: Server) -> None:
    headers = {"Authorization": f"Bearer {make_token()}"}
    for path, more, code in (("/", headers, "UOA-706"), ("/nowhere", {}, "UOA-705")):
        with pytest.raises(InvalidStatus) as refused:
            Talk(url(guarded, path), additional_headers=more)
        body = refused.value.response.body
        assert body is not None
        assert body.decode().endswith(f" ({code})\n")


def test_a_token_can_be_shown_in_three_places(guarded: Server) -> None:
    with enter(guarded, "viewer") as client:
        assert client.hello["role"] == "viewer"
    with Talk(url(guarded, f"/?token={TOKENS['driver']}")) as client:
        assert client.hello["role"] == "driver"
    offers = [JSON, Subprotocol(f"uoarm.token.{TOKENS['rightless']}")]
    with Talk(url(guarded), subprotocols=offers) as client:
        assert client.hello["role"] == "rightless"
        assert client.socket.subprotocol == JSON


def test_a_role_may_do_what_is_named_and_nothing_else(guarded: Server) -> None:
    with enter(guarded, "viewer") as viewer, enter(guarded, "driver") as driver:
        numbers = viewer.open("numbers")
        assert viewer.refused("Request", "echo")["code"] == "denied"
        assert viewer.refused("Call", "add", {"a": 1, "b": 1})["code"] == "denied"
        assert viewer.refused("Kill", numbers, {"everyone": True})["code"] == "denied"
        echo = driver.open("echo")
        driver.ask("Data", echo, {"value": 1})
        assert driver.ask("Call", "add", {"a": 1, "b": 1}) == {"value": 2}
        assert driver.refused("Request", "numbers")["code"] == "denied"
        assert driver.refused("Resolve", "numbers")["code"] == "denied"
        assert [function["name"] for function in driver.ask("List")["functions"]] == ["echo"]
        shown = driver.ask("Status")
        assert {connection["function"] for connection in shown["connections"]} == {"echo"}
        assert "numbers" not in str(shown)
        assert driver.refused("Kill", numbers, {"everyone": True})["code"] == "unknown"


def test_a_role_without_rules_may_do_nothing(guarded: Server) -> None:
    with enter(guarded, "rightless") as client:
        assert client.ask("List") == {"functions": []}
        for op in ("Request", "Resolve", "Call"):
            assert client.refused(op, "numbers")["code"] == "denied"


@pytest.mark.parametrize("op", ["Request", "Call", "Resolve", "Kill", "Data", "Stop"])
def test_no_error_names_a_function_that_the_role_does_not_see(guarded: Server, op: str) -> None:
    with enter(guarded, "guesser") as client:
        assert "'numberz'" in client.refused("Request", "numberz")["text"]
        for guess, hidden in (("numberz", "numbers"), ("doublet", "doubled"), ("ad", "add")):
            text = client.refused(op, guess, {"value": 1} if op in {"Call", "Data"} else None)
            assert hidden not in text["text"].replace(guess, "")


def test_changes_of_what_one_may_not_see_are_not_reported(guarded: Server) -> None:
    with enter(guarded, "driver") as driver, enter(guarded, "viewer") as viewer:
        driver.ask("Status", "watch")
        viewer.open("numbers")
        echo = driver.open("echo")
        driver.ask("Kill", echo)
        assert driver.next("change")["jsonMessage"]["subject"] == f"connection {echo}"


def test_changes_after_the_end_are_reported_to_roles_that_see_the_function(
    robot: RobotManager, guarded: Server
) -> None:
    go_on = threading.Event()
    with enter(guarded, "driver") as driver, enter(guarded, "viewer") as viewer:

        def hold_up(event: StatusEvent) -> None:
            assert go_on.wait(SECONDS), event

        end = robot.listen(hold_up)
        driver.ask("Status", "watch")
        viewer.open("numbers")
        echo = driver.open("echo")
        driver.ask("Kill", echo)
        go_on.set()
        assert driver.next("change")["jsonMessage"]["subject"] == f"connection {echo}"
        end()


def test_changes_of_what_the_application_itself_opens_and_kills_at_once_are_reported(
    robot: RobotManager, guarded: Server
) -> None:
    go_on = threading.Event()
    with enter(guarded, "driver") as driver:

        def hold_up(event: StatusEvent) -> None:
            assert go_on.wait(SECONDS), event

        end = robot.listen(hold_up)
        driver.ask("Status", "watch")
        robot.request("numbers").kill()
        mine = robot.request("echo")
        mine.kill()
        go_on.set()
        for change in ("opening", "running", "closed"):
            report = driver.next("change")["jsonMessage"]
            assert (report["subject"], report["change"]) == (f"connection {mine.id}", change)
            assert report["function"] == "echo"
        end()


def test_an_operator_may_kill_what_others_hold(guarded: Server) -> None:
    with enter(guarded, "viewer") as viewer, enter(guarded, "operator") as operator:
        numbers = viewer.open("numbers")
        operator.ask("Kill", numbers, {"everyone": True})
        assert viewer.next("connection")["jsonMessage"]["state"] == "closed"


def test_a_token_taken_back_ends_its_sessions_without_a_restart(
    guarded: Server, access: Path
) -> None:
    with enter(guarded, "viewer") as client, enter(guarded, "driver") as other:
        text = access.read_text(encoding="utf-8")
        fresh = make_token()
        replaced = text.replace(hash_token(TOKENS["viewer"]), hash_token(fresh))
        _replace(access, replaced)
        with pytest.raises(ConnectionClosed) as closed:
            client.answer(None)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008
        assert status_of(lambda: enter(guarded, "viewer")) == 401
        with Talk(url(guarded, f"/?token={fresh}")) as again:
            assert again.hello["role"] == "viewer"
        assert other.open("echo")


def test_rights_that_change_end_the_sessions_that_had_them(guarded: Server, access: Path) -> None:
    with enter(guarded, "viewer") as client, enter(guarded, "driver") as other:
        client.open("numbers")
        text = access.read_text(encoding="utf-8")
        _replace(access, text.replace('request: ["num*"]', 'request: ["echo"]'))
        with pytest.raises(ConnectionClosed) as closed:
            client.answer(None)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008
        assert other.open("echo")
    with enter(guarded, "viewer") as client:
        assert client.refused("Request", "numbers")["code"] == "denied"
        assert client.open("echo")


def test_an_access_file_with_mistakes_changes_nothing(
    guarded: Server, access: Path, caplog: pytest.LogCaptureFixture
) -> None:
    _replace(access, "version: 2\nroles: 5\n")
    eventually(lambda: "expected 1" in caplog.text, "the mistake is logged")
    with enter(guarded, "viewer") as client:
        assert client.open("numbers")


def test_metrics_need_a_role_that_sees_all(guarded: Server) -> None:
    from tests.server.test_serving import page

    assert page(guarded, "/healthz")[0] == 200
    assert page(guarded, "/metrics")[0] == 401
    assert page(guarded, "/metrics", Authorization=f"Bearer {TOKENS['driver']}")[0] == 403
    assert page(guarded, "/metrics", Authorization=f"Bearer {TOKENS['viewer']}")[0] == 200


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1", "http://", "http://[", "x"]
)
def test_strange_web_pages_may_not_connect(serve: Serve, origin: str) -> None:
    server = serve()
    assert status_of(lambda: Talk(url(server), origin=Origin(origin))) == 403


def test_own_pages_and_listed_ones_may_connect(serve: Serve) -> None:
    server = serve(origins=("https://panel.example",))
    for origin in (f"http://127.0.0.1:{server.ports[0]}", "https://panel.example"):
        with Talk(url(server), origin=Origin(origin)) as client:
            assert client.ask("List")


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", ""])
def test_a_strange_name_for_this_machine_is_refused(serve: Serve, host: str) -> None:
    from tests.server.test_serving import page

    server = serve()
    status, text = page(server, "/healthz", Host=host)
    assert (status, "--allow-host lets another name in" in text) == (403, True)
    assert page(server, "/healthz", Host="localhost")[0] == 200
    assert page(serve(hosts=("robot",)), "/healthz", Host="robot:1")[0] == 200


def test_a_client_of_another_version_is_refused_with_those_that_are_spoken(serve: Serve) -> None:
    server = serve()
    with pytest.raises(InvalidHandshake):
        Talk(url(server), subprotocols=[Subprotocol("uoarm.v9.json")])
    with Talk(url(server), subprotocols=[Subprotocol("uoarm.v9.json"), JSON]) as client:
        assert client.socket.subprotocol == JSON
    with Talk(url(server), subprotocols=None) as client:
        assert client.ask("List")


def test_what_is_denied_is_in_the_audit_log(
    guarded: Server, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "uoarm.audit")
    with enter(guarded, "rightless") as client:
        client.refused("Call", "add")
    text = caplog.text
    assert '"operation":"call","function":"add","allowed":false' in text
    assert status_of(lambda: Talk(url(guarded))) == 401
    assert "refused" in caplog.text
    assert not any(token in caplog.text for token in TOKENS.values())


def test_the_audit_log_is_appended_to_a_file_that_may_be_moved(
    serve: Serve, access: Path, tmp_path: Path
) -> None:
    kept = tmp_path / "audit.jsonl"
    kept.write_text("what was there\n", encoding="utf-8")
    server = serve(access=access, audit=kept)
    with enter(server, "rightless") as client:
        client.refused("Call", "add")
        kept.rename(tmp_path / "audit.jsonl.1")
        client.refused("Call", "add")
    before = (tmp_path / "audit.jsonl.1").read_text("utf-8").splitlines()
    assert before[0] == "what was there"
    assert json.loads(before[1])["began"] is True
    denied = [json.loads(line) for line in before[1:] if '"allowed":false' in line]
    assert [(line["operation"], line["function"]) for line in denied] == [("call", "add")]
    assert denied[0]["time"] > 1e9
    assert kept.stat().st_mode & 0o777 == 0o600
    assert '"allowed":false' in kept.read_text("utf-8")


def test_an_audit_log_that_cannot_be_written_keeps_the_server_from_starting(
    serve: Serve, tmp_path: Path
) -> None:
    with pytest.raises(ConfigurationError, match=r"audit log cannot be written to .*absent"):
        serve(audit=tmp_path / "absent" / "audit.jsonl")
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ConfigurationError, match=r"audit log cannot be written to .*pipe"):
        serve(audit=tmp_path / "pipe")  # which no one reads
    with pytest.raises(ConfigurationError, match=r"/dev/full: No space left .*; make room"):
        serve(audit=Path("/dev/full"))


def test_tls_is_spoken_where_there_is_a_certificate(serve: Serve, tmp_path: Path) -> None:
    certificate = Authority.of(tmp_path).certify_manager(["127.0.0.1"], days=1)
    server = serve(certificate=certificate, key=certificate.with_suffix(".key"))
    trust = ssl.create_default_context(cafile=tmp_path / "ca.pem")
    with Talk(f"wss://127.0.0.1:{server.ports[0]}/", ssl=trust) as client:
        assert client.ask("Call", "add", {"a": 1, "b": 1}) == {"value": 2}
    with pytest.raises(ConfigurationError, match="TLS"):
        serve(certificate=certificate, key=certificate)


TOKEN = f"version: 1\nroles: {{a: {{}}}}\ntokens: [{{role: a, sha256: {'a' * 64}, "


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[]", r"access.yaml:1:1: \$: expected names and values, got a list"),
        ("version: 1\nroles: {a: {fly: ['*']}}", "roles.a.fly: expected one of see"),
        ("version: 1\nroles: {a: {see: '*'}}", "expected a list"),
        ("version: 1\ntokens: [{role: x, sha256: ab}]", r"tokens\[0\].sha256: expected 64"),
        ("version: 1\ntokens: [{role: x}]", r"tokens\[0\].role: expected one of the roles"),
        ("version: 1\nrolls: {}", "rolls: unknown"),
        ("{", "this is not YAML"),
        ("", "expected names and values, got nothing"),
        ("version: true", r"\$.version: expected 1, got true"),
        ("version: 1\nroles: {a: {see: ['*']}}\nroles: {a: {kill: ['*']}}", "3:1: .*given twice"),
        ("version: 1\nroles:\n  a: {}\n  a: {}", r"4:3: \$.roles.a: the key \"a\" is given twice"),
        ("version: 1\nroles: {a: {see: [], see: ['*']}}", r"2:22: .* \"see\" is given twice"),
        (TOKEN + "expires: 2020-01-01T00:00:00Z, expires: 2999-01-01T00:00:00Z}]", "given twice"),
        (TOKEN + "sha256: x}]", '"sha256" is given twice'),
        (TOKEN + "expires: }]", "expires: expected a time such as"),
        (TOKEN + "expires: 2027-01-31}]", "expires: expected a time such as"),
        (TOKEN + "expires: 2027-13-31T00:00:00Z}]", "expires: expected a time such as"),
        ("version: 1\nroles: {a: {}}\ncertificates: {c: {role: a, name: d}}", "name: unknown"),
        ("version: 1\nroles: {a: {<<: {see: ['*']}}}", "merge keys"),
        ("version: 1\nroles: !!python/object:os.system {}", "tag"),
    ],
)
def test_mistakes_of_the_access_file_are_reported_with_their_place(
    tmp_path: Path, text: str, said: str
) -> None:
    path = tmp_path / "access.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError, match=said) as caught:
        read_access(path)
    assert caught.value.error_code in {"UOA-102", "UOA-106"}


def test_an_access_file_that_is_not_there_has_the_code_of_that(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="the file cannot be read") as caught:
        read_access(tmp_path / "access.yaml")
    assert caught.value.error_code == "UOA-101"


def test_the_limits_of_the_access_file_are_on_the_page() -> None:
    page = (Path(__file__).parents[2] / "docs" / "access.md").read_text(encoding="utf-8")
    assert f"{BUDGET.octets:,} bytes and {BUDGET.nodes:,} values" in page


def test_aliases_that_unfold_without_end_are_refused_before_they_do(tmp_path: Path) -> None:
    lines = ["version: 1", "roles:", "  a: {see: &a [x, x, x, x, x, x, x, x, x, x]}"]
    for level in "bcdefghijklmnopqrst":
        inner = ", ".join([f"*{chr(ord(level) - 1)}"] * 10)
        lines.append(f"  {level}: {{see: &{level} [{inner}]}}")
    path = tmp_path / "access.yaml"
    path.write_text("\n".join(lines), encoding="utf-8")
    with pytest.raises(ConfigurationError, match="more than 100,000 values, aliases counted"):
        read_access(path)


@pytest.mark.parametrize(
    ("text", "end"),
    [
        ("2027-01-31T10:00:00Z", datetime(2027, 1, 31, 10, tzinfo=timezone.utc)),
        ("2027-01-31T10:00:00+02:00", datetime(2027, 1, 31, 8, tzinfo=timezone.utc)),
        ("'2027-01-31 10:00:00.5'", datetime(2027, 1, 31, 10, 0, 0, 500_000, timezone.utc)),
    ],
)
def test_a_time_of_the_access_file_is_one_of_utc_where_it_names_no_zone(
    tmp_path: Path, text: str, end: datetime
) -> None:
    path = tmp_path / "access.yaml"
    path.write_text(f"{TOKEN}expires: {text}}}]", encoding="utf-8")
    assert [grant.expires for grant in read_access(path).tokens.values()] == [end]


def test_the_access_file_is_read_beside_the_loop_that_serves(
    guarded: Server, access: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    reading, go_on = threading.Event(), threading.Event()

    def slow(path: Path) -> AccessPolicy:
        reading.set()
        assert go_on.wait(SECONDS)
        return read_access(path)

    monkeypatch.setattr("uoarm.server.access._admission.read_access", slow)
    _replace(access, access.read_text(encoding="utf-8") + "\n# another\n")
    assert reading.wait(SECONDS)
    try:
        with enter(guarded, "viewer") as client:
            assert client.ask("List")
    finally:
        go_on.set()


@given(st.binary(max_size=80))
def test_no_access_file_at_all_crashes_the_reader(data: bytes) -> None:
    import tempfile

    with tempfile.NamedTemporaryFile(suffix=".yaml") as file:
        file.write(data)
        file.flush()
        try:
            book = read_access(Path(file.name))
        except ConfigurationError:
            return
        assert not book.tokens


def test_a_grant_ends_when_it_expires() -> None:
    role = AccessRole("r", {Operation.SEE: ("*",)})
    end = datetime(2030, 1, 1, tzinfo=timezone.utc)
    book = AccessPolicy({hash_token("t"): Grant("g", role, end)})
    assert book.grant_of(hash_token("t"), end - timedelta(seconds=1)) is not None
    assert book.grant_of(hash_token("t"), end) is None
    assert book.grant_of(hash_token("u"), end - timedelta(days=1)) is None


def _replace(path: Path, text: str) -> None:
    """Write a new file in the old one's place, as careful editors do."""
    fresh = path.with_suffix(".new")
    fresh.write_text(text, encoding="utf-8")
    fresh.replace(path)


def test_a_wrong_token_beside_a_certificate_makes_no_other_credentials(tmp_path: Path) -> None:
    text = """
version: 1
roles: {{viewer: {{see: all}}}}
certificates: {{desk: {{role: viewer}}}}
"""
    admission = Admission(access_file(tmp_path, text, {}))
    certificate = {"subject": ((("commonName", "desk"),),)}
    heads = [RequestHead("/", "localhost", None, token, upgrade=True) for token in ("", "a", "b")]
    assert {admission.admit(head, certificate) for head in heads} == {Credentials("", "desk")}


def test_names_and_addresses_of_others_are_for_whom_may_see_all(
    serve: Serve, tmp_path: Path
) -> None:
    access = tmp_path / "clients.yaml"
    access.write_text(
        f"""
version: 1
roles: {{owner: {{see: all, request: ["*"]}}, guest: {{see: ["numbers"], request: ["numbers"]}}}}
tokens:
  - {{name: first, principal: ada, role: owner, sha256: {hash_token("one")}}}
  - {{name: second, principal: bob, role: guest, sha256: {hash_token("two")}}}
""",
        encoding="utf-8",
    )
    url = f"ws://127.0.0.1:{serve(access=access).ports[0]}/"
    with Talk(f"{url}?token=one") as owner, Talk(f"{url}?token=two") as guest:
        connection = guest.open("numbers")
        clients = owner.ask("Status", message={"clients": True})["clients"]
        shown = {client["principal"]: client["connections"] for client in clients}
        assert shown == {"ada": [], "bob": [connection]}
        assert all(client["address"].startswith("127.0.0.1:") for client in clients)
        clients = guest.ask("Status", message={"clients": True})["clients"]
        assert [client["principal"] for client in clients] == ["bob"]
        assert "clients" not in owner.ask("Status")
