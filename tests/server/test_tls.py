"""TLS from outside: a certificate that the server makes, and clients known by theirs."""

from __future__ import annotations

import hashlib
import socket
import ssl
import stat
from contextlib import suppress
from datetime import datetime, timedelta, timezone
from pathlib import Path

import pytest
from tests.server.authority import Authority
from tests.server.conftest import Serve
from tests.server.lines import LINES
from tests.server.talk import SECONDS, Talk, TlsSocket
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus
from websockets.sync.client import connect

from uoarm.errors import ConfigurationError
from uoarm.server import Limits, Server, ServerOptions, fingerprint_of, hash_token
from uoarm.server.http._certificate import ShownCertificate, own_certificate
from uoarm.testing import patience, wait

ACCESS = """
version: 1
roles:
  driver: {{see: all, request: ["*"], send: ["*"], call: ["*"]}}
  viewer: {{see: all, request: ["numbers"]}}
tokens:
  - {{name: tablet, role: viewer, sha256: {tablet}}}
certificates:
  joystick.example: {{role: driver}}
  screen.example: {{role: viewer, expires: {ends}}}
"""
NOW = datetime(2027, 1, 1, tzinfo=timezone.utc)


@pytest.fixture
def authority(tmp_path: Path) -> Authority:
    return Authority(tmp_path)


@pytest.fixture
def access(tmp_path: Path) -> Path:
    path = tmp_path / "access.yaml"
    ends = datetime.now(timezone.utc) + timedelta(days=1)
    path.write_text(ACCESS.format(tablet=hash_token("tablet"), ends=ends.isoformat()))
    return path


@pytest.fixture
def server(serve: Serve, authority: Authority, access: Path) -> Server:
    certificate = authority.issue("server")
    return serve(
        front_ends=[LINES],
        access=access,
        certificate=certificate,
        client_authority=authority.path,
    )


def url(server: Server, path: str = "/") -> str:
    return f"wss://127.0.0.1:{server.ports[0]}{path}"


def known_by(authority: Authority, certificate: Path | None) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=authority.path)
    context.sslsocket_class = TlsSocket
    if certificate is not None:
        context.load_cert_chain(certificate)
    return context


def test_a_certificate_is_an_identity_with_a_role(server: Server, authority: Authority) -> None:
    joystick = known_by(authority, authority.issue("joystick.example"))
    screen = known_by(authority, authority.issue("screen.example"))
    with Talk(url(server), ssl=joystick) as client:
        assert client.hello["role"] == "driver"
        assert client.ask("Call", "add", {"a": 1, "b": 2}) == {"value": 3}
    with Talk(url(server), ssl=screen) as client:
        assert client.hello["role"] == "viewer"
        assert client.refused("Call", "add", {"a": 1, "b": 2})["code"] == "denied"
    with connect(url(server, "/lines"), ssl=joystick) as lines:
        lines.send('call add {"a": 1, "b": 2}')
        assert lines.recv(timeout=SECONDS) == '{"value":3}'
    with connect(url(server, "/lines"), ssl=screen) as lines:
        lines.send('call add {"a": 1, "b": 2}')
        assert str(lines.recv(timeout=SECONDS)).startswith("denied: ")


@pytest.mark.parametrize("version", [ssl.TLSVersion.TLSv1_2, ssl.TLSVersion.TLSv1_3])
def test_tls_from_1_2_on_is_spoken(
    server: Server, authority: Authority, version: ssl.TLSVersion
) -> None:
    context = known_by(authority, authority.issue("joystick.example"))
    context.minimum_version = context.maximum_version = version
    with Talk(url(server), ssl=context) as client:
        assert client.hello["role"] == "driver"


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the version that is asked for
def test_older_tls_is_refused(server: Server, authority: Authority) -> None:
    context = known_by(authority, authority.issue("joystick.example"))
    context.set_ciphers("ALL:@SECLEVEL=0")
    context.minimum_version = ssl.TLSVersion.TLSv1
    context.maximum_version = ssl.TLSVersion.TLSv1_1
    with pytest.raises((ssl.SSLError, ConnectionError)):
        Talk(url(server), ssl=context)


def test_no_certificate_or_one_without_a_role_needs_a_token(
    server: Server, authority: Authority
) -> None:
    for certificate in (None, authority.issue("stranger.example")):
        context = known_by(authority, certificate)
        with pytest.raises(InvalidStatus) as refused:
            Talk(url(server), ssl=context)
        assert refused.value.response.status_code == 401
        with Talk(url(server, "/?token=tablet"), ssl=context) as client:
            assert client.hello["role"] == "viewer"


@pytest.mark.parametrize("fault", ["another authority", "its time is over"])
def test_a_certificate_that_does_not_hold_gets_nowhere(
    server: Server, authority: Authority, tmp_path: Path, fault: str
) -> None:
    if fault == "another authority":
        (tmp_path / "other").mkdir()
        shown = Authority(tmp_path / "other").issue("joystick.example")
    else:
        shown = authority.issue("joystick.example", ends=timedelta(days=-1))
    with pytest.raises((OSError, InvalidHandshake, ConnectionClosed)) as raised:
        Talk(url(server), ssl=known_by(authority, shown))
    assert not isinstance(raised.value, InvalidStatus), "it got as far as HTTP"


def test_a_certificate_taken_out_of_the_file_ends_its_sessions(
    server: Server, authority: Authority, access: Path
) -> None:
    context = known_by(authority, authority.issue("joystick.example"))
    with Talk(url(server), ssl=context) as client:
        part = access.with_name("part")
        part.write_text(access.read_text().replace("joystick.example", "another.example"))
        part.replace(access)
        with pytest.raises(ConnectionClosed) as closed:
            client.answer(None)
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == 1008


def test_a_server_can_make_its_own_certificate(
    serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    server = serve(own_certificate=True)
    path = tmp_path / "uoarm" / "tls" / "server.pem"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    with Talk(url(server), ssl=ssl.create_default_context(cafile=path)) as client:
        assert client.hello["role"] == "local"
        der = client.socket.socket.getpeercert(binary_form=True)  # type: ignore[attr-defined]
    assert fingerprint_of(path).replace(":", "").lower() == hashlib.sha256(der).hexdigest()
    with pytest.raises(ssl.SSLCertVerificationError):
        Talk(url(server), ssl=ssl.create_default_context())


def test_its_own_certificate_is_kept_until_it_must_change(tmp_path: Path) -> None:
    def fingerprint(*names: str, days: int = 0) -> str:
        return fingerprint_of(own_certificate(tmp_path, names, NOW + timedelta(days=days)))

    first = fingerprint("robot.local")
    assert fingerprint("robot.local", days=300) == first
    assert fingerprint(days=300) == first
    soon = fingerprint(days=370)
    assert soon != first
    named = fingerprint("192.168.1.2", days=370)
    assert named != soon
    assert fingerprint("192.168.1.2", days=370) == named
    assert fingerprint("robot.local", days=370) == named, "several servers share it"
    (tmp_path / "server.pem").write_text("-----BEGIN CERTIFICATE-----\nx\n")
    assert fingerprint() not in {first, soon, named}


def test_a_key_that_others_can_read_is_refused(tmp_path: Path) -> None:
    own_certificate(tmp_path, ()).chmod(0o644)
    with pytest.raises(ConfigurationError, match="others may read"):
        own_certificate(tmp_path, ())


def test_a_place_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    (tmp_path / "tls").write_text("a file")
    with pytest.raises(ConfigurationError, match="own certificate"):
        own_certificate(tmp_path / "tls", ())
    with pytest.raises(ConfigurationError, match="no certificate"):
        fingerprint_of(tmp_path / "tls")


def test_settings_that_contradict_one_another_are_refused(
    serve: Serve, authority: Authority
) -> None:
    certificate = authority.issue("server")
    with pytest.raises(ConfigurationError, match="leave --certificate and --key out"):
        serve(certificate=certificate, own_certificate=True)
    with pytest.raises(ConfigurationError, match="--tls auto"):
        serve(client_authority=authority.path)


@pytest.mark.parametrize("said", [b"", b"\x16\x03\x01\x02\x00\x01"])
def test_a_slow_tls_handshake_is_given_up(serve: Serve, authority: Authority, said: bytes) -> None:
    server = serve(Limits(handshake_seconds=0.2), certificate=authority.issue("server"))
    with socket.create_connection(("127.0.0.1", server.ports[0]), timeout=SECONDS) as plain:
        plain.sendall(said)
        with suppress(ConnectionResetError):
            assert plain.recv(100) == b""


def shown_serial(server: Server, context: ssl.SSLContext) -> object:
    place = "127.0.0.1", server.ports[0]
    with (
        socket.create_connection(place, patience()) as plain,
        context.wrap_socket(plain, server_hostname="localhost") as tls,
    ):
        return (tls.getpeercert() or {})["serialNumber"]


async def test_what_another_server_makes_anew_is_not_shown_by_this_one(
    serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    server = serve(own_certificate=True)
    path = tmp_path / "uoarm" / "tls" / "server.pem"
    context = ssl.create_default_context(cafile=path)
    before = shown_serial(server, context)
    own_certificate(path.parent, ("another.local",))
    await server._read_again()
    assert shown_serial(server, context) == before


def test_a_renewed_certificate_is_shown_to_new_connections(
    serve: Serve, authority: Authority, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    shown = tmp_path / "shown.pem"
    context = ssl.create_default_context(cafile=authority.path)

    def put(content: bytes) -> None:
        part = tmp_path / "part"
        part.write_bytes(content)
        part.replace(shown)

    put(authority.issue("first").read_bytes())
    renewed = serve(certificate=shown)
    first = shown_serial(renewed, context)
    with Talk(url(renewed), ssl=context) as client:
        put(b"nothing")
        wait(lambda: "renewed files of TLS are not used" in caplog.text, "the mistake is logged")
        assert shown_serial(renewed, context) == first
        put(authority.issue("second").read_bytes())
        wait(lambda: shown_serial(renewed, context) != first, "the second one is shown")
        assert client.ask("Call", "add", {"a": 1, "b": 2}) == {"value": 3}


@pytest.mark.parametrize("own", [False, True])
def test_a_renewed_authority_is_the_one_that_new_connections_rest_on(
    serve: Serve,
    authority: Authority,
    access: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
    own: bool,
) -> None:
    (tmp_path / "next").mkdir()
    following = Authority(tmp_path / "next")
    trusted = tmp_path / "trusted.pem"
    trusted.write_bytes(authority.path.read_bytes())
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    if own:
        server = serve(access=access, own_certificate=True, client_authority=trusted)
        ca = tmp_path / "uoarm" / "tls" / "server.pem"
    else:
        shown, ca = authority.issue("server"), authority.path
        server = serve(access=access, certificate=shown, client_authority=trusted)
    before, after = ssl.create_default_context(cafile=ca), ssl.create_default_context(cafile=ca)
    for context, issuing in ((before, authority), (after, following)):
        context.sslsocket_class = TlsSocket
        context.load_cert_chain(issuing.issue("joystick.example"))

    def gets_in(context: ssl.SSLContext) -> bool:
        try:
            with Talk(url(server), ssl=context) as client:
                return bool(client.hello["role"] == "driver")
        except (OSError, InvalidHandshake, ConnectionClosed):
            return False

    assert (gets_in(before), gets_in(after)) == (True, False)
    part = tmp_path / "part"
    part.write_bytes(following.path.read_bytes())
    part.replace(trusted)
    wait(lambda: (gets_in(before), gets_in(after)) == (False, True), "the next one is trusted")
    if own:
        own_certificate(ca.parent, ("another.local",))
        part.write_bytes(authority.path.read_bytes())
        part.replace(trusted)
        wait(lambda: "was made anew: restart the server" in caplog.text, "it is refused")
        assert caplog.text.count("was made anew") == 1
        assert gets_in(after)


def test_the_end_of_a_certificate_is_logged_before_it_comes(
    authority: Authority, caplog: pytest.LogCaptureFixture
) -> None:
    path = authority.issue("server", ends=timedelta(days=90))
    certificate = ShownCertificate(path, None, None)
    for days, logged in ((0, []), (77, ["ends"]), (78, []), (91, ["has ended"]), (92, [])):
        caplog.clear()
        certificate.warn(datetime.now(timezone.utc) + timedelta(days=days))
        assert [str(record.args[1]) for record in caplog.records] == logged  # type: ignore[index]


@pytest.mark.parametrize("more", [{}, {"own_certificate": True}])
def test_a_key_alone_is_no_tls(authority: Authority, more: dict[str, bool]) -> None:
    with pytest.raises(ConfigurationError, match="--key"):
        ServerOptions(key=authority.issue("server"), **more).check()  # type: ignore[arg-type]
