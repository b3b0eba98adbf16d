"""The robot manager: ask it for a function, get a running connection."""

from __future__ import annotations

import itertools
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any, final, overload

from uoarm import config
from uoarm import record as recorder
from uoarm._arguments import arguments
from uoarm._bridges import BridgeSet
from uoarm._control.candidates import CandidateWatch
from uoarm._control.connection import Connection
from uoarm._control.live.driver import Driver
from uoarm._control.live.listeners import EventDispatcher
from uoarm._control.live.revisions import Revisions
from uoarm._control.requests import Requests, Services
from uoarm._control.robot_view import RobotView
from uoarm._dataplane import Clock
from uoarm._figures import observe
from uoarm._hints.applications import MessageType, T
from uoarm._interrupts import Uninterrupted, put_off
from uoarm._mistakes import choose
from uoarm._parts import StalenessWatch
from uoarm._raised import Log
from uoarm._resolve import Discovery
from uoarm._safety import EmergencyStop, StopFile
from uoarm._support import deadlines
from uoarm.bridge import Bridge, HealthEvent, Registry
from uoarm.config._keeping import KeptFile
from uoarm.errors import (
    UsageError,
)
from uoarm.model import (
    Deliver,
    Message,
    OfferStatus,
    Plan,
    QueuePolicy,
    Robot,
    StopReport,
    ValidationMode,
)

_log = Log("uoarm")
_INBOX = QueuePolicy(length=64)
_ENDED_RECORDINGS = 32
"""That are kept, to be looked at."""


@final
class RobotManager(RobotView):
    """Bridges, connections and status of one robot. A context manager; several may live at once.

    All methods may be called from any thread, callbacks and listeners included.

    Attributes:
        registry: the bridge plugins.

    Args:
        robot: the configuration, as `uoarm.config.load` returns it.
        registry: bridge plugins; None: those installed.
        bridges: ready instances by name, instead of making them from the configuration.
        clock: a monotonic clock, in seconds, for ages and rates.
        stop_file: a file that is there from `stop_all` to `release`, readable by this user only:
            a manager that is made while it is there begins stopped. One for each robot. None:
            a stop lasts as long as the manager.
    """

    @arguments(robot="RobotManager.from_file(path) reads a file")
    def __init__(
        self,
        robot: Robot,
        *,
        registry: Registry | None = None,
        bridges: Mapping[str, Bridge] | None = None,
        clock: Clock = time.monotonic,
        stop_file: str | PathLike[str] | None = None,
    ) -> None:
        self.registry = registry or Registry()
        self._file = KeptFile(robot)
        robot = config.assign(robot, self.registry.types)
        self._identity = secrets.token_hex(16)
        self._events = EventDispatcher(clock)
        self._bridges = BridgeSet(
            robot.bridges,
            self.registry,
            self._noticed,
            bridges or {},
            clock,
            robot.hosts,
            robot.origin,
            self._identity,
        )
        self._bridges.show(self.status)
        self._revisions = Revisions(
            robot,
            self._bridges,
            clock,
            lambda place, difference: self._events.post(f"lock {place}", "differs", difference),
        )
        self._driver = Driver(
            bridges=self._bridges,
            events=self._events,
            revisions=self._revisions,
            clock=clock,
            emergency_stop=EmergencyStop(
                clock,
                None if stop_file is None else StopFile(Path(stop_file).absolute()),
                self._bridges.stopping,
            ),
            functions=self,
        )
        self._discovery = Discovery(self._bridges.get)
        self._discovering = threading.Lock()
        self._candidates = CandidateWatch(
            self._revisions, self._driver, self._bridges.get, self.registry.types, clock
        )
        self._requests = Requests(
            self._revisions, self._driver, self._candidates, self._events, clock
        )
        self._services = Services(self._revisions, self._bridges, self._driver, clock)
        self._staleness = StalenessWatch(
            self._driver.live.shared,
            self._driver.live.feeding,
            self._stale,
            clock,
        )
        self._watch_rates(robot)
        # Those that run still end with the manager, whose connections they hold.
        self._recordings: dict[str, recorder.Recording] = {}
        self._recording_numbers = itertools.count(1)
        self._unobserve = observe(self._identity[:8], self.status)
        self._bridges.begin()

    @property
    def identity(self) -> str:
        """What other managers know this one by: random, and as long as the manager lives."""
        return self._identity

    @classmethod
    @arguments(path="RobotManager(robot) takes a Robot")
    def from_file(
        cls,
        path: str | PathLike[str],
        *,
        registry: Registry | None = None,
        clock: Clock = time.monotonic,
        stop_file: str | PathLike[str] | None = None,
    ) -> RobotManager:
        """Read a configuration file and make its manager; bridges start when needed.

        Raises:
            ConfigurationError: the file has mistakes; the text lists all of them. Or it asks for a
                lock that cannot be read.
        """
        registry = registry or Registry()
        robot = config.load(path, registry.types)
        return cls(robot, registry=registry, clock=clock, stop_file=stop_file)

    @overload
    def request(
        self,
        name: str,
        *,
        as_type: type[T],
        validate: ValidationMode | str = ...,
        queue: QueuePolicy | None = None,
        on_message: Callable[[T], None] | None = None,
        timeout: float = 60.0,
    ) -> Connection[T]: ...

    @overload
    def request(
        self,
        name: str,
        *,
        as_type: object = None,
        validate: ValidationMode | str = ...,
        queue: QueuePolicy | None = None,
        on_message: Deliver | None = None,
        timeout: float = 60.0,
    ) -> Connection: ...

    @arguments(name="robot.request('camera') asks for the function of that name")
    def request(
        self,
        name: str,
        *,
        as_type: Any = None,
        validate: ValidationMode | str = ValidationMode.SAMPLED,
        queue: QueuePolicy | None = None,
        on_message: Callable[[Any], None] | None = None,
        timeout: float = 60.0,
    ) -> Connection[Any]:
        """Resolve a function, open its whole plan and return the connection.

        Args:
            name: a function; `function.output` where it has several outputs.
            as_type: the type in which messages are wanted, such as a dataclass: whatever a Python
                component may have as a hint. It is proven that every message is one. None: plain
                values.
            validate: how many messages of outputs are checked against their structures; what is
                sent is checked always, unless this is off.
            queue: what to do when the application reads slower than messages come; None:
                the newest 64 are kept.
            on_message: a callback that receives the messages, from the first one on.
            timeout: seconds for everything: resolving, checking and opening.

        Raises:
            ResolutionError: nothing fits. Nothing was opened.
            BridgeError: a bridge failed while opening. Everything was closed again.
            BridgeTimeoutError: not open in time. Everything was closed again, or will be as
                soon as the bridge lets go.
            UsageError: the function has several outputs and the name does not say which, or
                there is no such way to validate, or a message may be no `as_type`.
        """
        self._require_open()
        mode = choose(ValidationMode, validate, "validate", UsageError)
        return self._requests.open(name, as_type, mode, queue or _INBOX, on_message, timeout)

    @overload
    def call(
        self, name: str, message: Message, *, as_type: type[T], timeout: float = 10.0
    ) -> T: ...

    @overload
    def call(
        self, name: str, message: Message, *, as_type: object = None, timeout: float = 10.0
    ) -> Message: ...

    @arguments(name="robot.call('light', message) calls the function of that name")
    def call(
        self, name: str, message: Message, *, as_type: Any = None, timeout: float = 10.0
    ) -> Message:
        """Call the service that provides a function and return its reply.

        Args:
            name: a function whose components are services.
            message: the request: plain values or objects, as `Connection.send` takes them; checked
                against the service's structure.
            as_type: the type in which the reply is wanted, as with `request`; None: plain values.
            timeout: seconds.

        Raises:
            ResolutionError: no service is available.
            MessageError: the request does not match the structure.
            CommandRefusedError: the service moves something, and the emergency stop refused or
                cancelled the call.
            BridgeError: the service failed or is gone, or its reply does not match the structure.
            BridgeTimeoutError: no reply in time, or within the lifetime of a call.
            UsageError: the function is a stream, or a reply may be no `as_type`.
        """
        wanted = None if as_type is None else MessageType(as_type, f"the reply of {name!r}")
        began = time.monotonic()
        # Each of both has its limit, which ends it in whatever thread it runs.
        provider = self.resolve(name, timeout=timeout).provider
        # In whole hundredths: bridges show it in their errors.
        left = max(0.0, round(timeout - (time.monotonic() - began), 2))
        return self._services.call(name, provider, message, wanted, left)

    def _call_planned(
        self,
        plan: Plan,
        message: Message,
        timeout: float,
        began: Callable[[Callable[[], bool]], object],
    ) -> Message:
        """Call the service of this very plan, and of no other; otherwise as `call`.

        Args:
            plan: found before.
            message: the request, plain values.
            timeout: seconds.
            began: called with what cancels the call, once it is about to be made.
        """
        return self._services.call(plan.function, plan.provider, message, None, timeout, began)

    @arguments(
        functions="robot.record('camera', path='run.mcap') records the function of that name"
    )
    def record(
        self,
        *functions: str,
        path: str | PathLike[str] | None = None,
        duration: float | None = None,
        max_size: int | str | None = None,
        split: int | str | None = None,
        compression: str | None = None,
        ring: float | None = None,
        queue: QueuePolicy | None = None,
        timeout: float = 60.0,
    ) -> recorder.Recording:
        """Record what functions give into an MCAP file, until the recording is closed.

        Each function is requested as by an application; a slow disk holds up no other reader. A
        file that is there already stays: the new one has the first number that is free in its
        name. Close it, use it in a `with` block, or close the manager: what is written last is the
        index. What goes wrong with the file ends the recording and nothing else.

        Args:
            functions: by name; `function.output` where one has several outputs. None at all: those
                of `record:` in the configuration, whose other lines then hold, too, where nothing
                else is said here.
            path: of the file.
            duration: seconds after which it ends; None: it does not by itself.
            max_size: octets of all its files after which it ends; a number, or a text as `2GB`.
            split: octets or seconds after which a new file begins, as `512MB` or `10min`.
            compression: `zstd`, `lz4` or `none`; None: `zstd`.
            ring: keep so many seconds in memory, and write them when something was lost or fails,
                or `Recording.dump` is called; None: everything is written.
            queue: what waits for the writer; None: ten thousand messages, the oldest are dropped.
            timeout: seconds for opening each function.

        Raises:
            ResolutionError: nothing fits, as from `request`; nothing is recorded then.
            BridgeError: a bridge failed while opening; likewise.
            PluginError: the extra `record` is not installed.
            UsageError: an option is wrong, the file cannot be made, or a function has no output.
        """
        self._require_open()
        given: dict[str, Any] = {
            "duration": duration,
            "max_size": max_size,
            "split": split,
            "compression": compression,
            "ring": ring,
            "queue": queue,
        }
        options = {name: value for name, value in given.items() if value is not None}
        settings = None if functions else self.config.record
        if settings is not None:
            functions, path = settings.functions, path or settings.path
            options = {**settings.options, **options}
        if path is None:
            raise UsageError("say into which file: path=...")
        recording = recorder.Recording(
            self,
            functions,
            Path(path).absolute(),
            recorder.RecordOptions.of(**options),
            self._events,
            timeout=timeout,
            identity=f"r{next(self._recording_numbers)}",
        )
        self._recordings[recording.id] = recording
        if self._driver.state.is_closing:  # meanwhile, and did not see it
            recording.close()
            self._require_open()
        ended = [kept for kept, other in tuple(self._recordings.items()) if other.ended]
        for kept in ended[:-_ENDED_RECORDINGS]:
            self._recordings.pop(kept, None)
        return recording

    def recordings(self) -> tuple[recorder.Recording, ...]:
        """Return the recordings that run, and the last of those that have ended, oldest first."""
        return tuple(self._recordings.values())

    @arguments()
    def playback(
        self,
        bridge: str,
        *,
        pause: bool | None = None,
        rate: float | str | None = None,
        seek: float | None = None,
        step: bool = False,
        timeout: float = 10.0,
    ) -> recorder.PlaybackStatus:
        """Move the recording that a bridge plays, and return where it is; alone, only that.

        Args:
            bridge: of the plugin `recording`.
            pause: True: stand; False: go on.
            rate: seconds of the recording in a second, or `fast`: as messages are taken.
            seek: go to so many seconds after its first message.
            step: let the next message pass, and stand.
            timeout: seconds.

        Raises:
            UsageError: the bridge plays no recording, or a value is wrong.
            BridgeError: it could not be started, or does not answer.
        """
        self._require_open()
        spec = self.config.bridges.get(bridge)
        if spec is None or spec.plugin != "recording":
            bridges = self.config.bridges.items()
            played = ", ".join(name for name, other in bridges if other.plugin == "recording")
            raise UsageError(f"bridge {bridge!r} plays no recording; those are: {played or 'none'}")
        move = partial(
            recorder.ask_playback,
            partial(self._bridges.get, bridge),
            pause=pause,
            rate=rate,
            seek=seek,
            step=step,
            timeout=timeout,
        )
        return deadlines.run(f"playback of {bridge!r}", timeout, move)

    @arguments(more="what is offered stands in the configuration, under `offer`")
    def offer(self, *, timeout: float = 60.0) -> tuple[OfferStatus, ...]:
        """Open what the configuration offers in frameworks, and keep it open until `close`.

        Each offer requests its function as an application does: a provider that dies is replaced
        behind it. One that cannot be opened, or that broke, is tried again, after a second at
        first and half a minute at last, and whenever a component or a bridge is well again.
        `apply` opens and closes what it changes. Idempotent.

        Args:
            timeout: seconds to wait for the first attempts; what takes longer goes on.

        Returns:
            every offer as it is then, with the cause where it failed.
        """
        self._require_open()
        return self._driver.offers.begin(timeout)

    @arguments()
    def stop_all(self, *, timeout: float = 2.0) -> StopReport:
        """Stop every input that moves something, and refuse commands until `release`.

        The stop message goes to all open inputs that have one at once, also to those that stand
        still; what opens meanwhile is stopped as it opens. Idempotent: a second call sends it
        again, and says how things are now. It waits for no lock or queue of messages.

        Args:
            timeout: seconds in which the inputs are waited for. The stop goes on being sent to
                those that have not taken it then.

        Returns:
            For every open input that moves something whether the framework took the stop message.

        Raises:
            ConnectionClosedError: this is a forked child, from which nothing can be stopped.
        """
        self._driver.require_own("the robot manager")
        return self._driver.live.emergency_stop.stop(timeout)

    @arguments()
    def release(self, *, timeout: float = 2.0) -> None:
        """Let commands through again; what has stopped stands still until the next one.

        Raises:
            BridgeError: some inputs could not be notified; they go on refusing commands. Or nothing
                was released: the stop file cannot be removed, or another stop came meanwhile.
        """
        self._driver.live.emergency_stop.release(timeout)

    @property
    def is_stopped(self) -> bool:
        """Whether commands are refused, from `stop_all` to `release`."""
        return self._driver.live.emergency_stop.is_held

    def close(self) -> None:
        """Kill every connection and close every bridge. Idempotent; bounded in time.

        In the main thread Ctrl-C and SIGTERM wait for its end; a second one is raised at once.
        In a child that was forked it does nothing: what is open is the parent's. In a finalizer
        that the garbage collector runs it only begins.
        """
        if put_off(self.close):
            return
        with Uninterrupted():
            if self._driver.is_foreign:
                return
            self._driver.live.emergency_stop.begin_close()
            self._unobserve()
            self._close_recordings()
            self._discovery.close()
            self._candidates.close()
            self._staleness.close()
            self._driver.offers.close()
            self._driver.close()
            self._close_recordings()  # that were opened meanwhile: now `record` sees that it closes
            for failure in self._bridges.close():
                _log.warning("%s", failure)
            self._events.close()

    def _close_recordings(self) -> None:
        for recording in tuple(self._recordings.values()):
            recording.close()

    def _stale(self, event: HealthEvent) -> None:
        with Uninterrupted():
            self._driver.report(event, is_avoided=True)
            self._driver.work()

    def _noticed(self, event: HealthEvent) -> Callable[[], object]:
        """Queue what a bridge reports; returns what handles it."""
        if not self._driver.offers.reported(event):
            self._driver.report(event)
        return self._driver.work

    def __repr__(self) -> str:
        name = self.config.origin or "in memory"
        functions, connections = len(self.config.functions), len(self.connections())
        return f"<RobotManager {name}: {functions} functions, {connections} connections>"

    def __enter__(self) -> RobotManager:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
