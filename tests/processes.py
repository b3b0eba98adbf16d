"""What the kernel reports of a process whose threads come and go. Linux."""

from collections.abc import Iterator
from pathlib import Path

__all__ = ["lives", "states", "thread_names"]


def lives(process: int) -> bool:
    """Say whether a process is there and has not ended."""
    return _status(Path(f"/proc/{process}"), "State")[:1] not in ("", "Z")


def states(process: int) -> list[str]:
    """Return the state of each thread of a process, a letter each, the main thread's first."""
    return [state[0] for home in _threads(process) if (state := _status(home, "State"))]


def thread_names(process: int) -> list[str]:
    """Return the names of the threads of a process, the main thread's first."""
    return [name for home in _threads(process) if (name := _status(home, "Name"))]


def _threads(process: int) -> Iterator[Path]:
    try:
        homes = list(Path(f"/proc/{process}/task").iterdir())
    except FileNotFoundError:
        return
    yield from sorted(homes, key=lambda home: home.name != str(process))


def _status(home: Path, field: str) -> str:
    """Return a field of a thread, nothing where it has ended, as it may between two reads."""
    try:
        lines = (home / "status").read_text(encoding="utf-8").splitlines()
    except (FileNotFoundError, ProcessLookupError):
        return ""
    return next(line.partition(":")[2].strip() for line in lines if line.startswith(f"{field}:"))
