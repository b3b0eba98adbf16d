"""Commands that ask a server over TLS: what they trust, and what they say when they do not."""

from __future__ import annotations

import subprocess
from datetime import timedelta
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.processes import run_program
from tests.server.authority import Authority
from tests.server.conftest import Serve
from tests.server.serving import access_file

import uoarm
from uoarm.cli import main
from uoarm.client import trust_fingerprint
from uoarm.errors import UsageError
from uoarm.server import Server, fingerprint_of
from uoarm.testing import patience

CLIENT = Path(uoarm.__file__).parent / "server" / "static" / "uoarm.js"
ACCESS = """
version: 1
roles:
  driver: {{see: all, stop: all}}
tokens:
  - {{name: tablet, role: driver, sha256: {tablet}}}
certificates:
  joystick.example: {{role: driver}}
"""


def url_of(server: Server) -> str:
    return f"wss://127.0.0.1:{server.ports[0]}/"


def ask(command: str, url: str, *more: object) -> tuple[int, str]:
    result = CliRunner().invoke(main, [command, "--url", url, *map(str, more)])
    return result.exit_code, result.output


@pytest.fixture
def access(tmp_path: Path) -> Path:
    return access_file(tmp_path, ACCESS, {"tablet": "tablet"})


def test_its_own_certificate_is_known_by_its_fingerprint(
    serve: Serve, access: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    url = url_of(serve(own_certificate=True, access=access))
    known = fingerprint_of(tmp_path / "uoarm" / "tls" / "server.pem")
    trusted = ("--fingerprint", known, "--token", "tablet")
    for command in ("stop", "status"):
        assert ask(command, url, *trusted)[0] == 0
    code, text = ask("status", url)
    assert (code, "self-signed" in text, "--fingerprint" in text) == (4, True, True)
    other = known.translate(str.maketrans("0123456789ABCDEF", "123456789ABCDEF0"))
    code, text = ask("stop", url, "--fingerprint", other, "--token", "tablet")
    assert (code, known.replace(":", "").lower() in text) == (4, True)
    code, text = ask("status", url, "--fingerprint", known)
    assert (code, "without a token" in text) == (4, True)
    code, text = ask("status", url.replace("wss", "ws"))
    assert (code, "with TLS it is wss://" in text) == (4, True)


@pytest.mark.needs("node")
def test_the_javascript_client_trusts_what_node_is_set_to_trust(
    serve: Serve, access: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    url = url_of(serve(own_certificate=True, access=access))
    pem = (tmp_path / "uoarm" / "tls" / "server.pem").read_text()
    (tmp_path / "robot.pem").write_text("-----BEGIN CERT" + pem.partition("-----BEGIN CERT")[2])
    program = tmp_path / "app.mjs"
    program.write_text(f"""
import {{ connect }} from "{CLIENT.as_uri()}";
const [url, token, seconds] = process.argv.slice(2);
const robot = await connect(url, {{ token, timeout: Number(seconds) }});
console.log(robot.hello.role);
await robot.close();
""")

    def run(token: str, more: str = "", **variables: str) -> subprocess.CompletedProcess[str]:
        flags = ["--experimental-websocket", "--no-warnings"]
        return run_program(
            "node", *flags, program, url + more, token, str(patience()), env=variables
        )

    trusting = {"NODE_EXTRA_CA_CERTS": str(tmp_path / "robot.pem")}
    for token in ("tablet", "tablet\n"):  # as it stands in a file
        assert run(token, **trusting).stdout == "driver\n"
    assert "token: expected what `uoarm token` prints" in run("two words", **trusting).stderr
    for refused in (run("tablet"), run("other", **trusting)):
        assert refused.returncode == 1
        assert f"{url}: nothing listens there, its certificate is not trusted" in refused.stderr
    assert f"{url}?token=***: nothing listens there" in run("x", "?token=s3cret").stderr


def test_an_authority_is_trusted_and_a_certificate_is_shown(
    serve: Serve, tmp_path: Path, access: Path
) -> None:
    authority = Authority(tmp_path)
    server = serve(
        access=access,
        certificate=authority.issue("server"),
        client_authority=authority.path,
    )
    joystick = authority.issue("joystick.example")
    trusted = ("--authority", authority.path, "--certificate", joystick)
    assert ask("stop", url_of(server), *trusted, "--key", joystick)[0] == 0
    assert ask("status", url_of(server), *trusted)[0] == 0
    assert ask("status", url_of(server), "--certificate", joystick)[0] == 4
    ended = authority.issue("joystick.example", ends=timedelta(days=-1))
    code, text = ask("status", url_of(server), *trusted[:2], "--certificate", ended)
    assert (code, "may not accept --certificate" in text) == (4, True)
    stranger = authority.issue("stranger.example")
    code, text = ask("status", url_of(server), *trusted[:2], "--certificate", stranger)
    assert (code, "or a --certificate whose name it has" in text) == (4, True)
    known = fingerprint_of(tmp_path / "server.pem")
    of_one = ("--fingerprint", known, "--token", "tablet")
    assert ask("status", url_of(server), *of_one)[0] == 0  # though it does not sign itself


@pytest.mark.parametrize(
    ("host", "ends", "said"),
    [
        ("localhost", -1, "certificate has expired; renew it there"),
        ("127.0.0.2", 1, "connect by an address that it has"),
    ],
)
def test_what_to_do_about_a_certificate_is_said(
    serve: Serve, access: Path, tmp_path: Path, host: str, ends: int, said: str
) -> None:
    authority = Authority(tmp_path)
    shown = authority.issue("server", ends=timedelta(days=ends))
    server = serve(access=access, certificate=shown, host=host)
    url = f"wss://{host}:{server.ports[0]}/"
    code, text = ask("status", url, "--authority", authority.path)
    assert (code, said in text) == (4, True), text


@pytest.mark.parametrize(
    ("url", "more", "said"),
    [
        ("ws://127.0.0.1:1/", ("--fingerprint", "ab"), "--fingerprint is for TLS"),
        ("wss://127.0.0.1:1/", ("--fingerprint", "ab", "--authority", __file__), "not both"),
        ("wss://127.0.0.1:1/", ("--key", __file__), "--certificate, which is missing"),
        ("wss://127.0.0.1:1/", ("--authority", "no such file"), "does not exist"),
    ],
)
def test_options_that_do_nothing_together_are_wrong_usage(
    url: str, more: tuple[str, ...], said: str
) -> None:
    code, text = ask("status", url, *more)
    assert (code, said in text) == (2, True), text


@pytest.mark.parametrize("more", [(), ("--json",)])
def test_an_error_does_not_show_the_token_of_an_address(more: tuple[str, ...]) -> None:
    code, text = ask("status", "ws://127.0.0.1:1/?token=s3cret", *more)
    assert (code, "s3cret" in text, "?token=***: nothing listens" in text) == (4, False, True)


@pytest.mark.parametrize("option", [("--refuse",), ("--cause", "not now")])
def test_what_is_refused_is_named(option: tuple[str, ...]) -> None:
    code, text = ask("approve", "ws://127.0.0.1:1/", *option)
    assert (code, "about one APPROVAL" in text) == (2, True), text


@pytest.mark.parametrize(
    ("url", "fingerprint", "said"),
    [
        ("wss://127.0.0.1:1/", "12:34", "64 hexadecimal digits, got 12:34"),
        ("wss://127.0.0.1:1/", "g" * 64, "64 hexadecimal digits"),
        ("ws://127.0.0.1:1/", "a" * 64, "expected wss://"),
        ("wss:///", "a" * 64, "expected wss://"),
        ("wss://127.0.0.1:99999/", "a" * 64, "expected wss://"),
    ],
)
def test_what_is_no_fingerprint_or_no_server_is_refused(
    url: str, fingerprint: str, said: str
) -> None:
    with pytest.raises(UsageError, match=said):
        trust_fingerprint(url, fingerprint)
