"""Fetching: whole or not at all, twice at most, and words for those without a network."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import shutil
from pathlib import Path

import pytest
from attrs import evolve
from vision_demo.footage import PACKAGES, PHOTOS, TALKING, prepare
from vision_demo.packages import FootageError, fetch

CONTENT = b"all of it"
PACKAGE = evolve(PHOTOS, sha256=hashlib.sha256(CONTENT).hexdigest())


class Client:
    """A client that leaves the given contents one after another; None: it fails."""

    def __init__(self, *contents: bytes | None) -> None:
        self.contents = list(contents)
        self.commands: list[list[str]] = []

    def __call__(self, command: list[str]) -> str:
        self.commands.append(command)
        content = self.contents.pop(0)
        if content is None:
            return "no route to host"
        folder = Path(command[command.index("--dest") + 1])
        (folder / PACKAGE.file).write_bytes(content)
        return ""


def test_a_whole_file_is_kept_and_not_fetched_again(tmp_path: Path) -> None:
    client = Client(CONTENT)
    file = fetch(PACKAGE, tmp_path, client)
    assert fetch(PACKAGE, tmp_path, client) == file
    assert file.read_bytes() == CONTENT
    assert list(tmp_path.iterdir()) == [file]
    assert len(client.commands) == 1
    assert client.commands[0][-1] == "face_recognition==1.3.0"
    assert "--no-deps" in client.commands[0]


@pytest.mark.parametrize("first", [b"half", b"", None])
def test_a_second_attempt_mends_the_first(tmp_path: Path, first: bytes | None) -> None:
    client = Client(first, CONTENT)
    assert fetch(PACKAGE, tmp_path, client).read_bytes() == CONTENT
    assert len(client.commands) == 2


def test_a_file_spoilt_in_the_cache_is_fetched_anew(tmp_path: Path) -> None:
    (tmp_path / PACKAGE.file).write_bytes(b"spoilt")
    assert fetch(PACKAGE, tmp_path, Client(CONTENT)).read_bytes() == CONTENT


def test_two_broken_files_are_an_error_that_says_so(tmp_path: Path) -> None:
    with pytest.raises(FootageError, match="not whole: expected sha256") as failed:
        fetch(PACKAGE, tmp_path, Client(b"half", b"half"))
    assert "tried 2 times" in str(failed.value)
    assert list(tmp_path.iterdir()) == []


def test_without_a_network_the_error_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(FootageError, match="no route to host") as failed:
        fetch(PACKAGE, tmp_path, Client(None, None))
    assert f"copy {PACKAGE.file} into {tmp_path}" in str(failed.value)


def test_a_missing_client_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FootageError, match="npm is not installed"):
        fetch(TALKING, tmp_path)
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(FootageError, match="pip is not installed"):
        fetch(PHOTOS, tmp_path)


def test_a_client_that_fails_is_quoted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_CONFIG_FILE", os.devnull)
    monkeypatch.setenv("PIP_FIND_LINKS", "")
    with pytest.raises(FootageError, match=r"tried 2 times: .*face_recognition"):
        fetch(PHOTOS, tmp_path)


def test_packages_are_reported_before_they_are_fetched(cache: Path) -> None:
    reports: list[str] = []
    prepare(cache, lambda package: reports.append(package.name))
    assert reports == [package.name for package in PACKAGES]


@pytest.mark.usefixtures("footage")
def test_what_an_earlier_version_left_is_not_played(cache: Path, tmp_path: Path) -> None:
    (tmp_path / "packages").mkdir()
    for file in (cache / "packages").iterdir():
        if file.is_file():
            shutil.copy(file, tmp_path / "packages")
    footage = prepare(tmp_path)
    old = footage.playlist / "0-old.jpg"
    old.write_bytes(b"whatever")
    assert {file.name for file in prepare(tmp_path).playlist.iterdir()} == set(footage.expected)
