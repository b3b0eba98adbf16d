"""With a full disk each step fails with one error, leaves nothing half made, can be repeated."""

from __future__ import annotations

import importlib
import os
import stat
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
from uoarm.server.http._certificate import own_certificate
from uoarm.testing import patience

HOSTED = """
version: 1
bridges: {far: {plugin: python, host: {silence: 600, start: 600}}}
functions:
  half: {components: [{name: halver, bridge: far, service: {endpoint: ["disk_parts:half"]}}]}
"""


def test_what_is_no_regular_file_is_not_replaced(tmp_path: Path) -> None:
    """As root even a device would be."""
    pipe, folder = tmp_path / "pipe", tmp_path / "folder"
    os.mkfifo(pipe)
    folder.mkdir()
    (tmp_path / "link").symlink_to(pipe)
    for name, why in (("pipe", "not a regular file"), ("link", "not a regular file")):
        for private in (False, True):
            with pytest.raises(OSError, match=rf"{why}: '\S+/{name}'$"):
                write_whole(tmp_path / name, b"new", private=private)
    with pytest.raises(IsADirectoryError, match=r"Is a directory: '\S+/folder'$"):
        write_whole(folder, b"new")
    with pytest.raises(FileNotFoundError, match=r"No such file or directory: '\S+/none/new'$"):
        write_whole(tmp_path / "none" / "new", b"new")
    assert stat.S_ISFIFO(pipe.stat().st_mode)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["folder", "link", "pipe"]
    robot = tmp_path / "robot.yaml"
    robot.write_text("version: 1\nbridges: {}\nfunctions: {}\n")
    for command in (
        ["lock", str(robot), "--lock", str(pipe)],
        ["types", "--python", str(robot), "-o", str(pipe)],
    ):
        done = CliRunner().invoke(main, command)
        assert done.exit_code == 3
        assert f"{pipe}: cannot be written: it is not a regular file" in done.stderr


def test_a_link_stays_and_a_file_keeps_its_mode(tmp_path: Path) -> None:
    file, link, new = tmp_path / "file", tmp_path / "link", tmp_path / "new"
    file.write_bytes(b"old")
    file.chmod(0o640)
    link.symlink_to(file)
    write_whole(link, b"new")
    assert link.is_symlink()
    assert file.read_bytes() == b"new"
    assert stat.S_IMODE(file.stat().st_mode) == 0o640
    link.unlink()
    link.symlink_to(new)
    write_whole(link, b"first")
    assert new.read_bytes() == b"first"
    write_whole(link, b"secret", private=True)
    assert not link.is_symlink()
    assert stat.S_IMODE(link.stat().st_mode) == 0o600
    assert new.read_bytes() == b"first"


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
    assert "cannot be made: File too large" in done.output
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
@pytest.mark.parametrize(
    "command",
    [
     ["check", "robot.yaml"], ["list"], ["bridges"], ["doctor"], ["--version"],
     ["schema", "check", "a.json", "a.json"], ["schema", "check", "a.json", "b.json", "--json"]],
)  # fmt: skip
def test_output_without_room_is_one_error(tmp_path: Path, command: list[str]) -> None:
    (tmp_path / "robot.yaml").write_text(HOSTED)
    _write_structures(tmp_path)
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "uoarm", *command],
            cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, timeout=patience(),
            check=False,
        )  # fmt: skip
    assert done.returncode == 6, done.stderr
    text = "error: nothing more can be written: No space left on device"
    lines = [text] if "schema" in command else [text, "uoarm explain UOA-003 says more"]
    assert done.stderr.splitlines() == lines


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device of Linux")
@pytest.mark.parametrize(
    "words", ["a.json a.json", "a.json b.json", "a.json none.json --json", "a.json b.json --json"]
)
def test_what_cannot_be_printed_is_no_verdict(tmp_path: Path, words: str) -> None:
    """Nor where it is read no more, as by `head`."""
    _write_structures(tmp_path)
    (tmp_path / "none.json").write_text("nothing")
    command = [sys.executable, "-m", "uoarm.schema", "check", *words.split()]
    unread, pipe = os.pipe()
    os.close(unread)
    full = os.open("/dev/full", os.O_WRONLY)
    text = "error: nothing more can be written: No space left on device\n"
    for place, said in ((full, text), (pipe, "")):
        done = subprocess.run(
            command,
            cwd=tmp_path, stdout=place, stderr=subprocess.PIPE, text=True, timeout=patience(),
            check=False,
        )  # fmt: skip
        os.close(place)
        assert (done.returncode, done.stderr) == (6, said)


def _write_structures(folder: Path) -> None:
    (folder / "a.json").write_text('{"type": "number"}')
    (folder / "b.json").write_text('{"type": "string"}')


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
