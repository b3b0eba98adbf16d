"""With a full disk each step fails with one error, leaves nothing half made, can be repeated."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from tests.disk import full_after
from tests.harness._places import unmeasured

from uoarm import RobotManager
from uoarm._support.certificates import Authority
from uoarm._support.files import write_whole
from uoarm.cli import main
from uoarm.config import loads
from uoarm.errors import ConfigurationError, UoarmError, UsageError
from uoarm.server.http._listener import own_certificate
from uoarm.testing import patience

HOSTED = """
version: 1
bridges: {far: {plugin: python, host: {silence: 600, start: 600}}}
functions:
  half: {components: [{name: halver, bridge: far, service: {endpoint: ["disk_parts:half"]}}]}
"""


@pytest.mark.parametrize("octets", [0, 100, 300])
def test_no_half_of_an_authority_is_left(tmp_path: Path, octets: int) -> None:
    folder = tmp_path / "certificates"
    with full_after(octets), pytest.raises(UsageError, match="File too large"):
        Authority.of(folder)
    assert list(folder.iterdir()) == []
    assert Authority.of(folder).certify_machine("arm", 1).exists()


@pytest.mark.parametrize("octets", [0, 100, 300])
def test_no_half_of_a_machines_certificate_is_left(tmp_path: Path, octets: int) -> None:
    authority = Authority.of(tmp_path)
    before = sorted(tmp_path.iterdir())
    with full_after(octets), pytest.raises(UsageError, match=r"arm\.pem cannot be made"):
        authority.certify_machine("arm", 1)
    assert sorted(tmp_path.iterdir()) == before
    assert authority.certify_machine("arm", 1).exists()


def test_the_servers_own_certificate_is_made_later(tmp_path: Path) -> None:
    with full_after(100), pytest.raises(ConfigurationError, match="File too large"):
        own_certificate(tmp_path, ())
    assert list(tmp_path.iterdir()) == []
    assert own_certificate(tmp_path, ()).exists()


def test_no_half_of_a_new_project_is_left(tmp_path: Path) -> None:
    command = ["new-bridge", "mine", "--into", str(tmp_path)]
    with full_after(500):
        done = CliRunner().invoke(main, command)
    assert done.exit_code == 1
    assert "cannot be made: [Errno 27] File too large" in done.output
    assert list(tmp_path.iterdir()) == []
    assert CliRunner().invoke(main, command).exit_code == 0


def test_a_host_that_cannot_be_started_is_an_error_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "disk_parts.py").write_text("def half(value: float) -> float: return value / 2\n")
    with (
        TemporaryDirectory() as scratch,  # paths of sockets must be short
        monkeypatch.context() as patch,
        RobotManager(loads(HOSTED, origin=str(tmp_path / "robot.yaml"))) as robot,
    ):
        patch.setattr("tempfile.tempdir", scratch)
        with (
            full_after(0),
            pytest.raises(UoarmError, match=r"no place for its link: .*File too large"),
        ):
            robot.call("half", 1.0)
        assert list(Path(scratch).iterdir()) == []
        assert robot.call("half", 1.0) == 0.5


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
@pytest.mark.parametrize("command", [["check", "robot.yaml"], ["list"], ["bridges"], ["doctor"]])
def test_output_without_room_is_one_error(tmp_path: Path, command: list[str]) -> None:
    (tmp_path / "robot.yaml").write_text(HOSTED)
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "uoarm", *command],
            cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, timeout=patience(),
            check=False,
        )  # fmt: skip
    assert done.returncode == 1
    text = "error: nothing more can be written: No space left on device"
    assert done.stderr.splitlines() == [text, "uoarm explain UOA-003 says more"]


def test_a_module_that_is_imported_meanwhile_leaves_no_half_of_its_bytecode(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "imported_meanwhile.py").write_text("numbers = [1, 2, 3] + list(range(100))\n")
    monkeypatch.syspath_prepend(tmp_path)
    with full_after(20):
        importlib.import_module("imported_meanwhile")
        subprocess.run(
            [sys.executable, "-c", "import imported_meanwhile"], cwd=tmp_path, check=True,
            env=unmeasured(),
        )  # fmt: skip
    assert [path.name for path in tmp_path.iterdir()] == ["imported_meanwhile.py"]
    del sys.modules["imported_meanwhile"]


@given(st.binary(max_size=2000), st.binary(max_size=2000), st.integers(0, 2000))
def test_a_file_is_the_old_one_or_the_new_one(
    tmp_path_factory: pytest.TempPathFactory, old: bytes, new: bytes, octets: int
) -> None:
    path = tmp_path_factory.getbasetemp() / "whole"
    write_whole(path, old)
    try:
        with full_after(octets):
            write_whole(path, new)
    except OSError:
        assert len(new) > octets
        assert path.read_bytes() == old
    else:
        assert path.read_bytes() == new
    assert not list(path.parent.glob(".whole*"))
