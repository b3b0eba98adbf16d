"""The robot manager: ask it for a function, get a running connection."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from os import PathLike
from types import TracebackType
from typing import final

from uoarm import _bounded
from uoarm._adapt import check_edge
from uoarm._control._attempt import Attempt
from uoarm._control._availability import check_availability
from uoarm._control._board import Board
from uoarm._control._bridges import BridgeSet
from uoarm._control._connection import Connection
from uoarm._control._failover import Failover
from uoarm._control._health import HealthDesk
from uoarm._control._ledger import Ledger
from uoarm._control._pool import Pool
from uoarm._control._prepare import prepare, reference
from uoarm._control._staleness import StalenessWatch
from uoarm._dataplane import Clock, make_check
from uoarm._mistakes import choose
from uoarm._resolve import Resolver, StructureCache
from uoarm.bridge import Bridge, HealthEvent, Registry, ServiceStructures
from uoarm.config import assign, load
from uoarm.errors import (
    BridgeError,
    FailureReason,
    MessageError,
    ResolutionError,
    UsageError,
)
from uoarm.model import (
    ConnectionState,
    Deliver,
    FunctionStatus,
    Message,
    Plan,
    QueuePolicy,
    Robot,
    StatusEvent,
    StatusMap,
    ValidationMode,
)

__all__ = ["RobotManager"]

_log = logging.getLogger("uoarm")
_INBOX = QueuePolicy(length=64)


@final
class RobotManager:
    """Bridges, connections and status of one robot. A context manager; several may live at once.

    All methods may be called from any thread, callbacks and listeners included.

    Attributes:
        config: the configuration, with the options that uoarm chose filled in.
        registry: the bridge plugins.

    Args:
        robot: the configuration, as `uoarm.config.load` returns it.
        registry: bridge plugins; None: those installed.
        bridges: ready instances by name, instead of making them from the configuration.
        clock: seconds that only grow, for ages and rates.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        registry: Registry | None = None,
        bridges: Mapping[str, Bridge] | None = None,
        clock: Clock = time.monotonic,
    ) -> None:
        self.registry = registry or Registry()
        self.config = robot = assign(robot, self.registry.types)
        self._clock = clock
        self._board = Board(clock)
        self._ledger = Ledger(self._board)
        self._bridges = BridgeSet(
            robot.bridges,
            self.registry,
            self._noticed,
            bridges or {},
            clock,
            robot.hosts,
            robot.origin,
        )
        self._structures = StructureCache(self._bridges.get)
        self._resolver = Resolver(robot, self._structures, check_edge, clock=clock)
        self._pool = Pool(self._bridges.get, clock)
        self._failover = Failover(
            robot.failover,
            resolve=self._resolve,
            forget=self._forget,
            pool=self._pool,
            ledger=self._ledger,
            board=self._board,
            clock=clock,
        )
        self._health = HealthDesk(
            self._pool,
            self._ledger,
            self._board,
            robot,
            forget=self._forget,
            bridges=self._bridges,
            failover=self._failover,
            clock=clock,
        )

        self._staleness = StalenessWatch(
            self._pool.components, self._pool.edges, self._noticed, clock
        )
        if any(one.expect for each in robot.components() for one in each.outputs):
            self._staleness.start()
        self._bridges.machines.begin()

    @classmethod
    def from_file(
        cls,
        path: str | PathLike[str],
        *,
        registry: Registry | None = None,
        clock: Clock = time.monotonic,
    ) -> RobotManager:
        """Read a configuration file and make its manager; bridges start when needed.

        Raises:
            ConfigurationError: the file has mistakes; the text lists all of them.
        """
        registry = registry or Registry()
        return cls(load(path, registry.types), registry=registry, clock=clock)

    def resolve(self, name: str, *, timeout: float = 60.0) -> Plan:
        """Return the plan that `request` would open, without opening anything.

        Asks bridges for structures that are not known yet; one that does not answer within half
        a minute is passed over.

        Raises:
            ResolutionError: nothing fits; the text says for every candidate why.
            BridgeTimeoutError: no plan within `timeout` seconds; the text says what hung.
        """
        self._ledger.require_open()
        function = reference(name).function
        known = self._resolver.known(function)
        if known is not None and not self._staleness.recent():
            return known
        return _bounded.run(f"resolving {function!r}", timeout, lambda: self._resolve(function))

    def request(
        self,
        name: str,
        *,
        validate: ValidationMode | str = ValidationMode.OFF,
        queue: QueuePolicy | None = None,
        on_message: Deliver | None = None,
        timeout: float = 60.0,
    ) -> Connection:
        """Resolve a function, open its whole plan and return the connection.

        Args:
            name: a function; `function.output` where it has several outputs.
            validate: how many messages are checked against their structures.
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
                there is no such way to validate.
        """
        self._ledger.require_open()
        mode = choose(ValidationMode, validate, "validate", UsageError)
        attempt = Attempt()

        def open_plan() -> Connection:
            connection = prepare(
                self.resolve(name, timeout=timeout),
                reference(name),
                self._ledger.new_id(),
                pool=self._pool,
                validate=mode,
                queue=queue or _INBOX,
                clock=self._clock,
            )
            if on_message is not None:
                connection.subscribe(on_message)
            attempt.adopt(connection)
            self._ledger.add(connection)
            connection.course.open()
            return connection

        try:
            return _bounded.run(f"request for {name!r}", timeout, open_plan)
        except BaseException as error:
            failed = attempt.give_up(str(error))
            for step in failed.plan.steps if failed is not None else ():
                self._forget(step.component.name)
            raise

    def call(self, name: str, message: Message, *, timeout: float = 10.0) -> Message:
        """Call the service that provides a function and return its reply.

        Args:
            name: a function whose components are services.
            message: the request, checked against the service's structure.
            timeout: seconds.

        Raises:
            ResolutionError: no service is available.
            MessageError: the request does not match the structure.
            BridgeError: the service failed or is gone, or its reply does not match the structure.
            BridgeTimeoutError: no reply in time.
            UsageError: the function is a stream.
        """
        return _bounded.run(
            f"call of {name!r}", timeout, lambda: self._call(name, message, timeout)
        )

    def connections(self) -> tuple[Connection, ...]:
        """Return the connections that have not ended, oldest first, whoever requested them."""
        return self._ledger.all()

    def status(self) -> StatusMap:
        """Return the whole system as it is at this moment."""
        connections = self.connections()
        shared = (edge.status() for edge in self._pool.edges())
        own = (route for connection in connections for route in connection.course.routes())
        return StatusMap(
            bridges=self._bridges.statuses(),
            components=tuple(live.status() for live in self._pool.components()),
            connections=tuple(connection.status() for connection in connections),
            routes=(*(route for route in shared if route is not None), *own),
            machines=self._bridges.machines.statuses(),
        )

    def check_availability(self) -> tuple[FunctionStatus, ...]:
        """Return which functions and components can be had now; opens nothing.

        Blocks while bridges are asked, several components at once, each within its limit.
        """
        self._ledger.require_open()
        for component in self.config.components():
            self._forget(component.name)
        return check_availability(self.config, self._structures, self.resolve)

    def listen(self, listener: Callable[[StatusEvent], None]) -> Callable[[], None]:
        """Tell a listener every change from now on, in order; returns what ends that.

        Listeners run in one thread of the manager, never in a thread that moves messages.
        """
        return self._board.listen(listener)

    def close(self) -> None:
        """Kill every connection and close every bridge. Once is enough; bounded in time."""
        self._staleness.close()
        self._failover.close()
        for connection in self._ledger.close():
            connection.course.end(ConnectionState.CLOSED, "the robot manager was closed")
        for failure in self._bridges.close():
            _log.warning("%s", failure)
        self._board.close()

    def _call(self, name: str, message: Message, timeout: float) -> Message:
        step = self.resolve(name, timeout=timeout).provider
        service = step.component.service
        if service is None:
            raise UsageError(f"function {name!r} is a stream: use request, not call")
        place = f"request to {step.component.name}"
        check = make_check(step.structures["request"], ValidationMode.ALWAYS, place)
        if check is not None:
            check(message)
        bridge = self._bridges.get(step.component.bridge)
        structures = ServiceStructures(step.structures["request"], step.structures["reply"])
        reply = bridge.call(service.endpoint, message, structures, timeout=timeout)
        place = f"the reply of the service {step.component.name}"
        check = make_check(step.structures["reply"], ValidationMode.ALWAYS, place)
        try:
            if check is not None:
                check(reply)
        except MessageError as error:
            raise BridgeError(str(error), FailureReason.BAD_MESSAGE) from error
        return reply

    def _resolve(self, name: str, excluded: frozenset[str] = frozenset()) -> Plan:
        """Resolve without what was stale lately; where there is nothing else, with it."""
        stale = self._staleness.recent() - excluded
        if stale:
            try:
                return self._resolver.resolve(name, excluded=excluded | stale)
            except ResolutionError:
                _log.debug("nothing but what was stale lately can provide %r", name)
        return self._resolver.resolve(name, excluded=excluded)

    def _forget(self, component: str) -> None:
        self._structures.forget(component)
        self._resolver.invalidate(component)

    def _noticed(self, event: HealthEvent) -> None:
        self._health.noticed(event)

    def __repr__(self) -> str:
        name = self.config.origin or "in memory"
        functions, connections = len(self.config.functions), len(self.connections())
        return f"<RobotManager {name}: {functions} functions, {connections} connections>"

    def __enter__(self) -> RobotManager:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
