"""What a robot manager shows of its robot: what is open, and what could be; opens nothing."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping

from uoarm._arguments import arguments
from uoarm._bridges import BridgeSet
from uoarm._control.candidates import CandidateWatch
from uoarm._control.configuration_changes import ConfiguredRobot
from uoarm._control.connection import Connection
from uoarm._control.live.listeners import EventDispatcher
from uoarm._control.requests import Requests, Services
from uoarm._parts import offered_structures
from uoarm._resolve import Discovery, Unavailable, check_availability, with_rates
from uoarm._support import deadlines
from uoarm.errors import ResolutionError
from uoarm.model import (
    BridgeFindings,
    FunctionStatus,
    MessageStructure,
    Offer,
    Plan,
    StatusEvent,
    StatusMap,
)

_DISCOVERY_SECONDS = 60.0


class RobotView(ConfiguredRobot):
    """The part of a robot manager that looks at its robot and changes nothing."""

    _bridges: BridgeSet
    _candidates: CandidateWatch
    _discovery: Discovery
    # Guards the discovery that is kept between looks, which is for one thread at a time.
    _discovering: threading.Lock
    _events: EventDispatcher
    _requests: Requests
    _services: Services

    @arguments()
    def resolve(self, name: str, *, timeout: float = 60.0) -> Plan:
        """Return the plan that `request` would open, without opening anything.

        Asks bridges for structures that are not known yet; one that does not answer within half
        a minute is passed over.

        Raises:
            ResolutionError: nothing fits; the text says for every candidate why.
            BridgeTimeoutError: no plan within `timeout` seconds; the text says what hung.
            UsageError: the function has no such output.
        """
        self._require_open()
        return self._requests.resolve(name, timeout)

    def connections(self) -> tuple[Connection, ...]:
        """Return the connections that have not ended, oldest first, of every caller."""
        runtimes = self._driver.live.connections()
        return tuple(runtime.handle for runtime in runtimes if runtime.handle is not None)

    def status(self) -> StatusMap:
        """Return the whole system as it is at this moment."""
        connections = self.connections()
        guard = self._revisions.current.guard
        own = (route for connection in connections for route in connection.routes())
        return StatusMap(
            bridges=self._bridges.statuses(),
            components=(*self._driver.live.statuses(), *self._services.statuses()),
            connections=tuple(connection.status() for connection in connections),
            routes=(
                *self._driver.live.routes(),
                *own,
                *self._driver.offers.routes(),
            ),
            machines=self._bridges.machines.statuses(),
            deaths=tuple(sorted(self._driver.deaths.copy().items())),
            takeovers=tuple(sorted(self._driver.takeovers.copy().items())),
            offers=self._driver.offers.statuses(),
            held=self._driver.live.emergency_stop.held(),
            lock=() if guard is None else guard.status(),
        )

    @arguments()
    def structures(
        self, component: str, *, timeout: float = 60.0
    ) -> Mapping[str, MessageStructure]:
        """Return the structures of a component's ports, as its bridge or the configuration has it.

        They are keyed `input.NAME` and `output.NAME`; a service has `request` and `reply`. Asks the
        bridge where that is not known yet, and opens nothing. An offer, `BRIDGE:FUNCTION`, has
        those that its framework knows: what it gives there is an input of the framework.

        Raises:
            ResolutionError: the configuration has no such component, or it is not there now.
            BridgeTimeoutError: the bridge did not answer within `timeout` seconds.
        """
        self._require_open()
        revision = self._revisions.current
        found = revision.named(component)
        if isinstance(found, Offer):
            what = f"asking for the structures of the offer {component!r}"
            get = self._bridges.get
            return deadlines.run(
                what, timeout, lambda: offered_structures(found, get(found.bridge))
            )
        if found is None:
            text = f"there is no component {component!r} in the configuration"
            raise ResolutionError(text, error_code="UOA-202")
        what = f"asking for the structures of {component!r}"
        answer = deadlines.run(what, timeout, lambda: revision.structures.structures(found))
        if isinstance(answer, Unavailable):
            text = f"component {component!r} is not there: {answer.sentence}"
            raise ResolutionError(text, error_code="UOA-212")
        return answer.by_port

    @arguments()
    def structure_of_type(self, name: str, *, timeout: float = 5.0) -> MessageStructure | None:
        """Return what messages of a native type are like, such as `std_msgs/msg/String`.

        Asks the plugins of the bridges in the configuration, in its order, and starts none of them;
        not those of bridges in hosts, whose types are those of another environment. None where no
        plugin knows the type.

        Args:
            name: of the type, as its framework spells it.
            timeout: seconds for each plugin.

        Raises:
            BridgeError: a plugin failed.
            BridgeTimeoutError: a plugin did not answer in time.
        """
        self._require_open()
        for spec in self.config.bridges.values():
            if spec.host is not None:
                continue
            found = self.registry.structure_of_type(spec, name, timeout)
            if found is not None:
                return found
        return None

    def check_availability(self) -> tuple[FunctionStatus, ...]:
        """Return which functions and components can be had now; opens nothing.

        Blocks while bridges are asked, several components at once, each within its limit.
        """
        self._require_open()
        self._candidates.wait(_DISCOVERY_SECONDS)
        revision = self._revisions.current
        revision.forget([component.name for component in revision.robot.components()])
        return check_availability(revision.robot, revision.structures, self.resolve)

    @arguments()
    def discover(
        self, *, timeout: float = 10.0, grace: float | None = None
    ) -> tuple[BridgeFindings, ...]:
        """Return what every bridge sees now, configured or not; opens nothing.

        Args:
            timeout: seconds for each bridge, its start included; all are asked at once.
            grace: seconds that the others have after the first answer. A slower bridge is listed as
                it answered the last call with a grace, or as one that has not answered yet; what
                it answers is in a later such call. None: every bridge is waited for.
        """
        self._require_open()
        base = self._revisions.current.base
        if grace is not None:
            with self._discovering:
                return self._with_rates(self._discovery.look(base, timeout, grace))
        discovery = Discovery(self._bridges.get)
        try:
            return self._with_rates(discovery.look(base, timeout))
        finally:
            discovery.close()

    @arguments()
    def listen(self, listener: Callable[[StatusEvent], None]) -> Callable[[], None]:
        """Notify a listener of every change from now on, in order; returns what ends that.

        Listeners run in one thread of the manager, never in a thread that moves messages.
        """
        return self._events.listen(listener)

    def _observe(self, observer: Callable[[StatusEvent], None]) -> Callable[[], None]:
        """Call an observer as each change is posted; see `EventDispatcher.observe`."""
        return self._events.observe(observer)

    def _with_rates(self, findings: tuple[BridgeFindings, ...]) -> tuple[BridgeFindings, ...]:
        own = [route for connection in self.connections() for route in connection.routes()]
        rates = {
            route_status.producer: route_status.rate
            for route_status in (*self._driver.live.routes(), *own)
            if route_status.rate is not None
        }
        return with_rates(findings, rates, self.config)
