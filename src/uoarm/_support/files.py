"""Files that are there whole or not at all, also when the disk is full or the process is killed.

Paths may begin with `~`, and programs keep things in folders of the user who runs them.
What users name is read in one way: a regular file, up to a limit; what is wrong is worded once.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from uoarm.errors import UsageError

_FOLDERS = {"cache": "~/.cache", "data": "~/.local/share", "state": "~/.local/state"}


class UnreadableFileError(ValueError):
    """A file cannot be read as text.

    Attributes:
        sentence: what is wrong with it.
        hint: what to do, empty where the sentence says it.
        line: where that is, from one on; 0: it is about the whole file.
    """

    def __init__(self, sentence: str, hint: str = "", line: int = 0) -> None:
        super().__init__(f"{sentence} ({hint})" if hint else sentence)
        self.sentence, self.hint, self.line = sentence, hint, line


def read_text(path: Path, limit: int) -> str:
    """Return the text of a regular file: a pipe or device could go on for ever.

    Args:
        path: of the file.
        limit: the most octets that it may have.

    Raises:
        UnreadableFileError: it cannot be read, has more, or is not UTF-8.
    """
    raw = read_octets(path, limit)
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        sentence = f"the file is not UTF-8: byte {error.start + 1:,} cannot be decoded"
        line = raw[: error.start].count(b"\n") + 1
        raise UnreadableFileError(sentence, "save it as UTF-8", line) from error


def read_octets(path: Path, limit: int) -> bytes:
    """Return what stands in a regular file; as `read_text`."""
    try:
        return _octets(path, limit)
    except OSError as error:
        raise UnreadableFileError(f"the file cannot be read: {error.strerror or error}") from error
    except ValueError as error:
        raise UnreadableFileError(f"the file cannot be read: {error}") from error


def _octets(path: Path, limit: int) -> bytes:
    if path.is_dir():
        raise ValueError("it is a folder")
    with open_regular(path) as stream:
        raw = stream.read(limit + 1)
    if len(raw) > limit:
        raise ValueError(f"it has more than {limit:,} bytes")
    return raw


def open_regular(path: Path) -> BinaryIO:
    """Open a file for reading, but no pipe, whose other end may never be opened, and no device.

    Raises:
        OSError: it cannot be read, or is none.
    """
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    return path.open("rb")


def end_of_lines(text: str) -> str:
    """Return what ends the lines of a text, as its first line shows."""
    first = text.splitlines(keepends=True)[0] if text else ""
    return "\r\n" if first.endswith("\r\n") else "\n"


def write_whole(path: Path, data: bytes, *, private: bool = False) -> None:
    """Write a file beside its place and move it there; one that stands there is replaced.

    Args:
        path: of the file.
        data: what stands in it.
        private: only its owner may read it, from its first octet on.

    Raises:
        OSError: it cannot be written; then nothing of it is left, and what was there still is.
    """
    with written_beside(path, data, private=private) as put_in_place:
        put_in_place()


@contextmanager
def written_beside(
    path: Path, data: bytes, *, private: bool = False
) -> Iterator[Callable[[], object]]:
    """Write a file beside its place; give what moves it there. It is gone where that is not called.

    A link stays, and what it leads to is replaced, with the mode that it had; of a private file
    the link is: it may be another user's.

    Raises:
        OSError: as `write_whole`; or what is there is no regular file, such as a device.
    """
    named, path = path, path if private else Path(os.path.realpath(path))
    mode = 0o600 if private else 0o666
    before = None
    with suppress(FileNotFoundError):
        before = mode_of_regular(named)
    part = path.with_name(f".{path.name}.{os.getpid()}")
    part.unlink(missing_ok=True)  # of a process that was killed, and had this number
    try:
        place = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode if before is None else 0)
        with os.fdopen(place, "wb") as file:
            file.write(data)
            file.flush()
            if before is not None:
                os.fchmod(file.fileno(), mode if private else before)
            os.fsync(file.fileno())
        yield lambda: part.replace(path)
    except OSError as error:
        if error.filename == str(part):  # who reads the error knows only the file that was meant
            raise OSError(error.errno, error.strerror, str(named)) from error
        raise
    finally:
        part.unlink(missing_ok=True)


def mode_of_regular(path: Path) -> int:
    """Return the mode of a regular file.

    Raises:
        OSError: there is none, or another thing: as root a device would be replaced, and who opens
            a pipe waits for its other end.
    """
    mode = path.stat().st_mode
    if stat.S_ISDIR(mode):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    return stat.S_IMODE(mode)


def stamp_of(path: Path) -> tuple[int, ...]:
    """Return what distinguishes a file from what it was before; () where there is none."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return found.st_mtime_ns, found.st_size, found.st_ino


def lock_path(configuration: str | Path) -> Path:
    """Return where the lock of a configuration's file is: beside it, `cart.lock` of `cart.yaml`."""
    path = Path(configuration)
    is_yaml = path.suffix in (".yaml", ".yml")
    return path.with_suffix(".lock") if is_yaml else path.with_name(f"{path.name}.lock")


def expanded(path: str | Path) -> Path:
    """Return a path in which `~` and `~NAME` are replaced.

    They stay where no home is known: what is wrong with the path names it as it was written.
    """
    return Path(os.path.expanduser(path))  # noqa: PTH111 - that of pathlib raises RuntimeError


def user_folder(kind: str) -> Path:
    """Return where uoarm keeps what is of this user: `cache`, `data` or `state`.

    These are the folders of https://specifications.freedesktop.org/basedir-spec; they need not be
    there yet.

    Raises:
        UsageError: the user has no home, and no variable names a folder.
    """
    variable = f"XDG_{kind.upper()}_HOME"
    named = os.environ.get(variable) or _FOLDERS[kind]
    folder = expanded(named)
    if str(folder).startswith("~"):
        text = f"{named}: this user has no home: set {variable} to a folder that can be written"
        raise UsageError(text)
    return folder / "uoarm"
