"""Changes of the configuration while the manager runs: tried, refused or put into force."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, nullcontext
from functools import partial
from pathlib import Path

from attrs import evolve

from uoarm import config
from uoarm._control.live.driver import Driver
from uoarm._control.live.revisions import Revisions
from uoarm._control.offers import Offers
from uoarm._resolve import without_candidates
from uoarm._support import deadlines
from uoarm._support.files import written_beside
from uoarm.bridge import BridgeType
from uoarm.errors import ConfigurationError, UsageError
from uoarm.model import ConfigurationChange, Effect, Robot

__all__ = ["ConfigurationChanges", "KeptFile"]

_MOST_OCTETS = 10_000_000


class KeptFile:
    """A configuration file, and what stood in it when it was read or written last.

    Of two writers none undoes the other's change unseen: where another writer has written since,
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
            UsageError: the configuration is of no file, or another writer has changed that.
            ConfigurationError: the change cannot be written line by line.
        """
        self._require_unchanged(self._known())
        return config.rewrite(self._text, wanted)

    @contextmanager
    def written(self, text: str) -> Iterator[None]:
        """Write the file beside its place, and put it there as the block ends without an error.

        What can fail for want of room has failed before the block begins.

        Raises:
            UsageError: another writer has changed the file meanwhile; that change stands.
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

    def _require_unchanged(self, path: Path, intro: str = "") -> None:
        try:
            with path.open("rb") as file:
                now = file.read(_MOST_OCTETS + 1)
        except OSError as error:
            raise ConfigurationError(f"{intro}{path} cannot be read: {error}") from error
        if now.decode(errors="replace").removeprefix("\ufeff") != self._text:
            raise UsageError(
                f"{intro}{path} was changed since it was read: reload it, and make the change anew"
            )


@contextmanager
def _writing(place: Path, intro: str = "") -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise ConfigurationError(f"{intro}{place} cannot be written: {error}") from error


class ConfigurationChanges:
    """Changes the configuration, one change at a time; for any thread.

    Args:
        file: of the configuration, where a change is kept that is to be kept.
        types: of bridges, by name.
        revisions: of the configuration.
        driver: has the connections move to their new plans.
        offers: follow the configuration.
        before: called with a configuration that is to be in force, before it is.
    """

    def __init__(
        self,
        file: KeptFile,
        types: Mapping[str, BridgeType],
        revisions: Revisions,
        driver: Driver,
        offers: Offers,
        before: Callable[[Robot], None],
    ) -> None:
        self._file = file
        self._types = types
        self._revisions = revisions
        self._driver = driver
        self._offers = offers
        self._before = before

    def note(self, robot: Robot) -> None:
        """Note a configuration that was read from its file and is in force."""
        self._file.note(robot)

    def apply(
        self,
        robot: Robot,
        *,
        is_dry_run: bool,
        is_forced: bool,
        revision: int | None,
        keeps: bool,
        reloads_code: bool,
        timeout: float,
    ) -> ConfigurationChange:
        """Put a configuration into force; arguments and errors as `RobotManager.apply` has them."""
        what = "finding out what the change of configuration would do"
        with self._revisions.alone(timeout):
            self._revisions.require(revision)
            robot = config.with_code(config.assign(robot, self._types), None)
            if keeps:
                robot = evolve(robot, text=self._file.prepare(self._written(robot)))
            robot = config.with_code(
                robot, self._revisions.current.robot, uuid.uuid4().hex if reloads_code else ""
            )
            staged = deadlines.run(
                what,
                timeout,
                partial(self._revisions.stage, robot, self._driver, is_new_code=reloads_code),
                on_late=lambda late: late.bridges.close(),
            )
            gone = self._offers.connections_without(robot)
            ending = [
                connection
                for connection in staged.change.connections
                if connection.effect is Effect.ENDS and connection.connection not in gone
            ]
            with ExitStack() as refused:
                refused.callback(staged.bridges.close)
                if is_dry_run:
                    return staged.change
                if ending and not is_forced:
                    text = "\n".join(f"  {effect}" for effect in ending)
                    raise ConfigurationError(
                        f"the change would end connections; force it, or kill them first:\n{text}"
                    )
                self._before(robot)
                with self._file.written(robot.text) if keeps else nullcontext():
                    refused.pop_all()  # from here on the bridges are those in force
                    self._driver.configure(staged, timeout)
                    self._offers.follow()
            if keeps:
                self._revisions.note_kept()
            return self._revisions.history()[-1]

    def _written(self, robot: Robot) -> str:
        """Return the text of a configuration, which must be all that is in it.

        Raises:
            UsageError: it was built, or changed since it was read.
        """
        read = config.loads(robot.text, robot.origin) if robot.text else Robot({}, {})
        known = config.assign(read, self._types)
        if not robot.text or not config.is_same(known, without_candidates(robot)):
            raise UsageError("only a configuration that was read from text can be kept in a file")
        return robot.text
