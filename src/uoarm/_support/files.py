"""Files that are there whole or not at all, also when the disk is full or the process is killed."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["stamp_of", "write_whole", "written_beside"]


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

    Raises:
        OSError: as `write_whole`.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}")
    part.unlink(missing_ok=True)  # of a process that was killed, and had this number
    try:
        place = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600 if private else 0o666)
        with os.fdopen(place, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        yield lambda: part.replace(path)
    except OSError as error:
        if error.filename == str(part):  # who reads the error knows only the file that was meant
            error.filename, error.filename2 = str(path), None
        raise
    finally:
        part.unlink(missing_ok=True)


def stamp_of(path: Path) -> tuple[int, ...]:
    """Return what distinguishes a file from what it was before; () where there is none."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return found.st_mtime_ns, found.st_size, found.st_ino
