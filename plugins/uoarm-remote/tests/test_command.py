"""`uoarm fleet`: every manager's status, or why it is not known."""

from __future__ import annotations

import json
import ssl
from pathlib import Path

import pytest
from robots import ServedRobot, fleet
from tests.processes import run_python  # type: ignore[import-not-found]
from tests.redirects import redirecting  # type: ignore[import-not-found]
from uoarm_remote._link import why_unreachable

from uoarm.server import ServerOptions, serve_in_thread
from uoarm.testing import patience


def desk(folder: Path, **urls: str) -> str:
    """Write a configuration that imports from managers; returns its file."""
    bridges = "".join(
        f"  {name}: {{plugin: remote, options: {{url: '{url}', timeout: {patience()}}}}}\n"
        for name, url in urls.items()
    )
    file = folder / "desk.yaml"
    file.write_text(f"version: 1\nbridges:\n  python: {{}}\n{bridges}functions: {{}}\n")
    return str(file)


def test_every_manager_is_shown(
    robot: ServedRobot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with robot.manager.request("counter"):
        assert fleet(desk(tmp_path, first=robot.url, second=robot.url)) == 0
    shown = capsys.readouterr().out
    assert shown.startswith(f"first  {robot.url}\n  ")
    assert f"\nsecond  {robot.url}\n" in shown
    assert "counter" in shown


def test_one_that_is_not_reached_is_named_beside_the_others(
    robot: ServedRobot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gone = ServedRobot()
    gone.close()
    assert fleet(desk(tmp_path, first=gone.url, second=robot.url), "--json") == 4
    first, second = json.loads(capsys.readouterr().out)
    assert (first["bridge"], first["url"], first["status"]) == ("first", gone.url, None)
    assert "nothing listens there" in first["cause"]
    assert (first["error_code"], second["error_code"]) == ("UOA-402", "")
    assert second["cause"] == ""
    assert second["status"]["connections"] == []
    assert fleet(desk(tmp_path, first=gone.url)) == 4
    assert "first  ws://127.0.0.1:" in (text := capsys.readouterr().out)
    assert "not reached: nothing listens there" in text


@pytest.mark.parametrize(
    ("fingerprint", "why"), [(":".join(["AB"] * 32), "its fingerprint is"), ("", "self-signed")]
)
def test_a_certificate_that_is_not_trusted_is_shown_with_what_to_compare(
    robot: ServedRobot,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    fingerprint: str,
    why: str,
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    secured = ServerOptions(port=0, own_certificate=True)
    with serve_in_thread(robot.manager, secured) as server:
        url = f"wss://localhost:{server.ports[0]}/"
        file = Path(desk(tmp_path, first=url))
        if fingerprint:
            more = f"url: '{url}', fingerprint: '{fingerprint}'"
            file.write_text(file.read_text().replace(f"url: '{url}'", more))
        assert fleet(str(file)) == 4
    shown = capsys.readouterr().out
    assert f"its certificate is not trusted: {why}" in shown
    assert "compare `fingerprint` with what `uoarm serve` prints there" in shown


def test_a_redirection_is_said_with_what_to_do(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with redirecting("http://robot.example/ros/") as place:
        assert fleet(desk(tmp_path, first=place)) == 4
    shown = capsys.readouterr().out
    assert "not reached: it redirects: give ws://robot.example/ros/ as the address" in shown


def test_tls_that_is_not_asked_for_is_said_with_what_to_do(
    robot: ServedRobot, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    secured = ServerOptions(port=0, own_certificate=True)
    with serve_in_thread(robot.manager, secured) as server:
        assert fleet(desk(tmp_path, first=f"ws://localhost:{server.ports[0]}/")) == 4
    shown = capsys.readouterr().out
    assert "not reached: no HTTP/1.1 is spoken there: with TLS it is wss://" in shown


def test_a_certificate_that_has_ended_asks_for_no_fingerprint() -> None:
    why = "its certificate is not trusted: certificate has expired; renew it there, or look at"
    error = ssl.SSLCertVerificationError(1, "x")
    error.verify_code, error.verify_message = 10, "certificate has expired"
    assert why_unreachable(error, "wss://there/") == f"{why} this machine's clock"


def test_a_configuration_that_is_wrong_or_imports_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fleet(desk(tmp_path, first="http://nowhere/")) == 3
    assert "url" in capsys.readouterr().err
    assert fleet(str(tmp_path / "missing.yaml")) == 3
    capsys.readouterr()
    file = desk(tmp_path)
    assert fleet(file) == 0
    assert capsys.readouterr().out == f"{file} imports from no other manager\n"


def test_the_status_of_all_is_that_of_the_fleet(robot: ServedRobot, tmp_path: Path) -> None:
    shown = run_python(
        "-m", "uoarm", "status", "--all", desk(tmp_path, first=robot.url), check=True
    )
    assert shown.stdout.startswith(f"first  {robot.url}\n  ")


def test_it_is_a_command_of_uoarm() -> None:
    shown = run_python("-m", "uoarm", "fleet", "--help", check=True)
    assert "uoarm fleet" in shown.stdout


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["-f", "none.yaml"], 3, "none.yaml: the file cannot be read"),
        (["a.yaml", "--file", "none.yaml"], 2, "the configuration is named twice"),
        (["--browse", "--file", "a.yaml"], 2, "--browse reads no configuration: leave a.yaml out"),
        (["--seconds", "1"], 2, "without --browse there is no use for --seconds"),
        (["--browse", "--seconds", "nan"], 2, "expected more than 0 and up to 60, got nan"),
        (["--browse", "--seconds", "x"], 2, "expected more than 0 and up to 60, got x"),
    ],
)
def test_wrong_words_are_one_clear_error(
    words: list[str], code: int, text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fleet(*words) == code
    assert text in capsys.readouterr().err
