"""Changes of the configuration while the manager runs: tried, refused or put into force."""

from __future__ import annotations

import uuid
from collections.abc import Callable, Mapping
from contextlib import ExitStack, nullcontext

from attrs import evolve

from uoarm import _bounded
from uoarm._control.offers.offers import Offers
from uoarm._control.runtime.executor import Executor
from uoarm._control.runtime.kept_file import KeptFile
from uoarm._control.runtime.revisions import Revisions
from uoarm._resolve import without_candidates
from uoarm.bridge import BridgeType
from uoarm.config import assign, is_same, loads, with_code
from uoarm.errors import ConfigurationError, UsageError
from uoarm.model import ConfigurationChange, Effect, Robot

__all__ = ["ConfigurationChanges"]


class ConfigurationChanges:
    """Changes the configuration, one change at a time; for any thread.

    Args:
        file: of the configuration, where a change is kept that is to be kept.
        types: of bridges, by name.
        revisions: of the configuration.
        executor: has the connections move to their new plans.
        offers: follow the configuration.
        before: called with a configuration that is to be in force, before it is.
    """

    def __init__(
        self,
        file: KeptFile,
        types: Mapping[str, BridgeType],
        revisions: Revisions,
        executor: Executor,
        offers: Offers,
        before: Callable[[Robot], None],
    ) -> None:
        self._file = file
        self._types = types
        self._revisions = revisions
        self._executor = executor
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
            robot = with_code(assign(robot, self._types), None)
            if keeps:
                robot = evolve(robot, text=self._file.prepare(self._written(robot)))
            robot = with_code(
                robot, self._revisions.current.robot, uuid.uuid4().hex if reloads_code else ""
            )
            staged = _bounded.run(
                what,
                timeout,
                lambda: self._revisions.stage(
                    robot, lambda: self._executor.state, is_new_code=reloads_code
                ),
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
                    self._executor.configure(staged, timeout)
                    self._offers.follow()
            if keeps:
                self._revisions.note_kept()
            return self._revisions.history()[-1]

    def _written(self, robot: Robot) -> str:
        """Return the text of a configuration, which must be all that is in it.

        Raises:
            UsageError: it was built, or changed since it was read.
        """
        read = loads(robot.text, robot.origin) if robot.text else Robot({}, {})
        if not robot.text or not is_same(assign(read, self._types), without_candidates(robot)):
            raise UsageError("only a configuration that was read from text can be kept in a file")
        return robot.text
