"""The file of a configuration, which is written when that is asked, and only as it was read."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from uoarm._whole_file import written_beside
from uoarm.config import rewrite
from uoarm.errors import ConfigurationError, UsageError
from uoarm.model import Robot

__all__ = ["KeptFile"]

_MOST_OCTETS = 10_000_000


class KeptFile:
    """A configuration file, and what stood in it when it was read or written last.

    Of two writers none undoes the other's change unseen: where somebody else has written since,
    nothing is. For one thread at a time.

    Args:
        robot: the configuration as it was read.
    """

    def __init__(self, robot: Robot) -> None:
        self._path = Path(robot.origin) if robot.origin else None
        self._text = robot.text

    def note(self, robot: Robot) -> None:
        """Note a configuration that was read from a file; another file than this one is nothing."""
        if self._path is not None and Path(robot.origin) == self._path:
            self._text = robot.text

    def prepare(self, wanted: str) -> str:
        """Return what would stand in the file with another configuration; writes nothing.

        Raises:
            UsageError: the configuration is of no file, or somebody else has changed that.
            ConfigurationError: the change cannot be written line by line.
        """
        self._require_unchanged(self._known())
        return rewrite(self._text, wanted)

    @contextmanager
    def written(self, text: str) -> Iterator[None]:
        """Write the file beside its place, and put it there as the block ends without an error.

        What can fail for want of room has failed before the block begins.

        Raises:
            UsageError: somebody else has changed the file meanwhile; theirs stands.
            ConfigurationError: it cannot be written.
        """
        place = self._known().resolve()
        with ExitStack() as stack:
            with _writing(place):
                mode = place.stat().st_mode
                beside = written_beside(place, text.encode(), private=True)
                put_in_place = stack.enter_context(beside)
            yield  # outside of the above: a limit that is over is an OSError, too
            self._require_unchanged(place, "the change is in force, but not kept: ")
            with _writing(place, "the change is in force, but "):
                put_in_place()
                place.chmod(mode)
        self._text = text

    def _known(self) -> Path:
        if self._path is None:
            raise UsageError(
                "the configuration in force is of no file: there is none to keep it in"
            )
        return self._path

    def _require_unchanged(self, path: Path, told: str = "") -> None:
        try:
            with path.open("rb") as file:
                now = file.read(_MOST_OCTETS + 1)
        except OSError as error:
            raise ConfigurationError(f"{told}{path} cannot be read: {error}") from error
        if now.decode(errors="replace").removeprefix("\ufeff") != self._text:
            raise UsageError(
                f"{told}{path} was changed since it was read: reload it, and make the change anew"
            )


@contextmanager
def _writing(place: Path, told: str = "") -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise ConfigurationError(f"{told}{place} cannot be written: {error}") from error
