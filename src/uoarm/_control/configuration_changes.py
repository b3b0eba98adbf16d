"""Changes of the configuration while the manager runs: tried, refused or put into force."""

from __future__ import annotations

import uuid
from contextlib import ExitStack, nullcontext
from functools import partial
from os import PathLike

from attrs import evolve

from uoarm import config
from uoarm._arguments import arguments
from uoarm._control.live.driver import Driver
from uoarm._control.live.revisions import Revisions, StagedRevision
from uoarm._parts import StalenessWatch
from uoarm._resolve import without_candidates
from uoarm._support import deadlines
from uoarm.bridge import Registry
from uoarm.config._keeping import KeptFile
from uoarm.errors import ConfigurationError, ConnectionClosedError, UsageError
from uoarm.model import ConfigurationChange, Effect, Robot


class ConfiguredRobot:
    """The part of a robot manager that has a configuration, which may change while it runs."""

    registry: Registry
    _driver: Driver
    _revisions: Revisions
    _file: KeptFile
    _staleness: StalenessWatch

    @property
    def config(self) -> Robot:
        """The configuration in force, with the options that uoarm chose filled in.

        Functions with needs have the candidates that were discovered, behind those named.
        """
        return self._revisions.current.robot

    @property
    def revision(self) -> int:
        """How many changes of the configuration led to the one in force."""
        return self._revisions.current.number

    @arguments(robot="reload(path) reads a file, uoarm.config.load(path) too")
    def apply(
        self,
        robot: Robot,
        *,
        dry_run: bool = False,
        force: bool = False,
        revision: int | None = None,
        keep: bool = False,
        reload_code: bool = False,
        timeout: float = 60.0,
    ) -> ConfigurationChange:
        """Change the configuration while the manager runs; one change at a time.

        The configuration in force, word for word, makes no revision: what is returned has the
        number of the one in force, and no differences.

        Connections whose plan stays as it is notice nothing. The others go on with their new
        plans as after a failover, with a gap noted: what is new opens beside what runs, and takes
        its place. Where that cannot be (a device that can be open once only), what the new
        configuration has no more is closed first. Takeovers of that kind are not counted for
        `failover.limit`.

        Args:
            robot: the configuration, as `uoarm.config.load` returns it.
            dry_run: whether to say only what would happen. Bridges that are new or others are
                started for that, asked for structures and closed again.
            force: whether connections may end for it that find no other plan.
            revision: of the configuration that the change was made for; None: any.
            keep: whether it is written to the file of the configuration in force, whose comments
                and order stay; else the file stays as it is.
            reload_code: whether the code of Python components is read again. Each is then a new
                instance, which takes the place of the one that runs. Where one cannot be had with
                its new code, nothing changes.
            timeout: seconds, for finding out what would happen, and once more for moving.

        Raises:
            ConfigurationError: connections would end, a component cannot be had with its new code,
                or other machines cannot join at the address that it has for them. Or the file
                cannot be written. Nothing has changed, unless the text says that it is in force.
            UsageError: another revision is in force. Or it cannot be kept: nothing was read from a
                file, or another writer has changed the file. Nothing has changed, unless likewise.
            BridgeTimeoutError: a bridge hangs. Nothing has changed, unless the text says that
                connections were changing already.
        """
        self._require_open()
        with self._revisions.alone(timeout):
            self._revisions.require(revision)
            robot = config.with_code(config.assign(robot, self.registry.types), None)
            if keep:
                robot = evolve(robot, text=self._file.prepare(self._written(robot)))
            code = uuid.uuid4().hex if reload_code else ""
            robot = config.with_code(robot, self._revisions.current.robot, code)
            staged = deadlines.run(
                "finding out what the change of configuration would do",
                timeout,
                partial(self._revisions.stage, robot, self._driver, is_new_code=reload_code),
                on_late=lambda late: late.bridges.close(),
            )
            with ExitStack() as refused:
                refused.callback(staged.bridges.close)
                if dry_run:
                    return staged.change
                if not (staged.is_new or keep):
                    now = self._revisions.history()[-1]
                    return evolve(
                        staged.change, revision=now.revision, is_applied=True, time=now.time
                    )
                if not force:
                    self._require_none_ends(staged)
                self._watch_rates(robot)
                with self._file.written(robot.text) if keep else nullcontext():
                    # From here on the bridges are those in force, unless it was closed meanwhile.
                    closing = refused.pop_all()
                    try:
                        self._driver.configure(staged, timeout)
                    except ConnectionClosedError:
                        closing.close()
                        raise
                    self._driver.offers.follow()
            if keep:
                self._revisions.note_kept()
            return self._revisions.history()[-1]

    @arguments(path="apply(robot) takes a Robot")
    def reload(
        self,
        path: str | PathLike[str] | None = None,
        *,
        dry_run: bool = False,
        force: bool = False,
        reload_code: bool = False,
        timeout: float = 60.0,
    ) -> ConfigurationChange:
        """Read a configuration file and `apply` it; None: the file that is in force, again.

        The code of Python components goes on as it is, unless `reload_code` asks for it anew.

        Raises:
            UsageError: the configuration in force is of no file, and no other is named.
            ConfigurationError: the file has mistakes, all of which the text lists, or as `apply`.
        """
        path = path or self.config.origin
        if not path:
            raise UsageError("the configuration was not read from a file: name one")
        robot = config.load(path, self.registry.types)
        change = self.apply(
            robot, dry_run=dry_run, force=force, reload_code=reload_code, timeout=timeout
        )
        if change.is_applied:
            self._file.note(robot)
        return change

    @arguments()
    def rollback(
        self,
        to: int,
        *,
        dry_run: bool = False,
        force: bool = False,
        revision: int | None = None,
        keep: bool = False,
        timeout: float = 60.0,
    ) -> ConfigurationChange:
        """Apply the configuration of an earlier revision again, as a revision of its own.

        Args:
            to: the number of the revision.
            dry_run: as `apply` has it, and so `force`, `revision`, `keep` and `timeout`.
            force: likewise.
            revision: likewise.
            keep: likewise.
            timeout: likewise.

        Raises:
            UsageError: there is no such revision, or it was too long ago; or as `apply`.
            ConfigurationError: as `apply`.
        """
        kept = {change.revision: change.robot for change in self.history()}
        robot = kept.get(to)
        if robot is None:
            raise UsageError(f"revision {to} is not kept: {min(kept)} to {max(kept)} are")
        return self.apply(
            robot, dry_run=dry_run, force=force, revision=revision, keep=keep, timeout=timeout
        )

    def history(self) -> tuple[ConfigurationChange, ...]:
        """Return the last revisions of the configuration, the one in force last.

        A hundred, or fewer of large ones: about 32 MiB in all, and at least the one before.
        """
        return self._revisions.history()

    def _require_none_ends(self, staged: StagedRevision) -> None:
        # What is offered no more ends with its offer.
        gone = self._driver.offers.connections_without(staged.revision.robot)
        ending = [
            f"  {effect}"
            for effect in staged.change.connections
            if effect.effect is Effect.ENDS and effect.connection not in gone
        ]
        if ending:
            text = "the change would end connections; force it, or kill them first:"
            raise ConfigurationError("\n".join([text, *ending]))

    def _written(self, robot: Robot) -> str:
        """Return the text of a configuration, which must be all that is in it.

        Raises:
            UsageError: it was built, or changed since it was read.
        """
        read = config.loads(robot.text, robot.origin) if robot.text else Robot({}, {})
        known = config.assign(read, self.registry.types)
        if not robot.text or not config.is_same(known, without_candidates(robot)):
            raise UsageError("only a configuration that was read from text can be kept in a file")
        return robot.text

    def _watch_rates(self, robot: Robot) -> None:
        if any(output.expect for component in robot.components() for output in component.outputs):
            self._staleness.start()
            self._driver.when_changed = self._staleness.changed

    def _require_open(self) -> None:
        self._driver.require_own("the robot manager")
        if self._driver.state.is_closing:
            raise ConnectionClosedError("the robot manager is closed")
