"""`uoarm host` says what it needs before it does anything."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.cli.terminal import on_a_terminal
from tests.host.joined import robot

from uoarm.cli import main


@pytest.mark.parametrize(
    "words",
    [
        "",
        "far",
        "--machine arm",
        "--join tls/127.0.0.1:7447",
        "one two --xmlrpc 0",
        "arm --xmlrpc 0 --machine hand",
        "far --xmlrpc 0 --join tls/127.0.0.1:7447 --machine arm",
    ],
)
def test_half_of_what_it_needs_is_not_enough(words: str) -> None:
    done = CliRunner().invoke(main, ["host", *words.split()])
    assert done.exit_code == 2
    assert "give --join PLACE and --machine NAME, or one BRIDGE and --xmlrpc PORT" in done.output


def test_it_joins_no_other_machine_without_tls() -> None:
    words = ["--join", "tcp/192.0.2.1:7447", "--machine", "arm"]
    done = CliRunner().invoke(main, ["host", *words])
    assert done.exit_code == 2
    assert "--join tcp/192.0.2.1:7447: without TLS only on loopback" in done.output


def test_a_certificate_that_is_not_there_is_named(tmp_path: Path) -> None:
    words = ["--join", "tls/192.0.2.1:7447", "--machine", "arm", "--certificates", str(tmp_path)]
    done = CliRunner().invoke(main, ["host", *words])
    assert done.exit_code == 4
    assert f"there is no {tmp_path}/ca.pem" in done.output


def test_a_bridge_of_another_machine_has_no_xml_rpc_here(tmp_path: Path) -> None:
    file = robot(tmp_path, 7447)
    done = CliRunner().invoke(main, ["host", "far", "--xmlrpc", "0", "-f", str(file)])
    assert done.exit_code == 4
    assert "bridge 'far' is on machine 'arm': ask its manager" in done.output


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_to_end_what_answers_over_xml_rpc_is_no_failure(
    tmp_path: Path, number: signal.Signals
) -> None:
    text = "version: 1\nbridges: {python: {}}\nfunctions: {}\n"
    (tmp_path / "robot.yaml").write_text(text, encoding="utf-8")
    words = ["host", "python", "--xmlrpc", "0"]
    seen = on_a_terminal(words, tmp_path, interrupt_at="/RPC2", number=number)
    assert seen.code == 0, seen.text
