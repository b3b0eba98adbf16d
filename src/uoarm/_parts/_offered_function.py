"""One function as a framework finds it: requested like any other, proven to fit, routed out."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Protocol

from uoarm._adapt import check_edge, transfer
from uoarm._dataplane import Clock, Outlet, Route
from uoarm._raised import Log, on_failure
from uoarm.bridge import Bridge, Channel, ServiceStructures
from uoarm.errors import BridgeError, ResolutionError
from uoarm.model import (
    ConnectionState,
    Edge,
    Meaning,
    Message,
    MessageStructure,
    Offer,
    OfferedPort,
    OfferedService,
    Plan,
    RouteStatus,
    format_reason,
)

_OPEN_SECONDS = 10.0
_DESCRIBE_SECONDS = 10.0
_CLOSE_SECONDS = 2.0
_KEPT_PROOFS = 16
_GOAL, _STATUS = "goal", "status"
_GOAL_ENDS = frozenset({"succeeded", "canceled", "aborted", "lost"})
_log = Log("uoarm")

Transfer = Callable[[Message], Message]


class Functions(Protocol):
    """What a manager gives to the callers of functions."""

    def resolve(self, name: str) -> Plan:
        """Return the plan that a request would open."""

    def request(self, name: str) -> Any:
        """Open a function and return its connection."""

    def call(self, name: str, message: Message, *, timeout: float) -> Message:
        """Call the service of a function."""


class _ServiceProof:
    """The adapters between the callers of an offered service and one plan of its function."""

    def __init__(self, offer: Offer, service: OfferedService, plan: Plan, bridge: Bridge) -> None:
        given = plan.provider.structures
        if "request" not in given:
            raise ResolutionError(f"function {offer.function!r} has streams and no service")
        said = bridge.describe(service.endpoint, timeout=_DESCRIBE_SECONDS)
        asked = _settled(service.request, said.request, given["request"], service.request_mapping)
        answered = _settled(service.reply, said.reply, given["reply"], service.reply_mapping)
        self.structures = ServiceStructures(asked, answered)
        self.request = _proven(
            "what callers ask does not fit the service",
            Edge(offer.name, "request", offer.function, "request", asked, given["request"],
                 service.request_mapping, service.request_losses),
            service.meaning,
        )  # fmt: skip
        self.reply = _proven(
            "what the service replies does not fit what callers get",
            Edge(offer.function, "reply", offer.name, "reply", given["reply"], answered,
                 service.reply_mapping, service.reply_losses),
            service.meaning,
        )  # fmt: skip


class _GoalWatch:
    """The goals that an offered function has: each that goes with a provider is reported as lost.

    A function is an action where it takes a `goal` and emits a `status`, which has `goal_id` and
    `status` as docs/serve.md says. The sender of a goal that was refused, or whose provider died or
    was replaced, would wait for ever; so the status says it in the provider's place.

    Args:
        give: takes a status in the framework.
    """

    def __init__(self, connection: Any, give: Callable[[Message], None]) -> None:
        self._connection = connection
        self._give = give
        # Held while a status is given: one is given at a time, and none of a goal after its end.
        self._lock = threading.RLock()
        self._unanswered: deque[object] = deque()
        self._running: dict[str, object] = {}

    def send(self, message: Message) -> None:
        """Hand a goal to the provider of now; one that is refused is reported as rejected."""
        # Read before the goal goes in: one that meets a change of provider is lost, never kept.
        provider = self._provider()
        with self._lock:
            self._unanswered.append(provider)
        with on_failure(self._report, "", "rejected"):
            self._connection.send(message, _GOAL)

    def report(self, message: Message) -> None:
        """Give a status of a provider."""
        if isinstance(message, Mapping):
            self._report(str(message.get("goal_id")), str(message.get("status")), message)

    def look(self) -> None:
        """Report goals whose provider is not the one of now; called after each change."""
        provider = self._provider()
        with self._lock:
            refused = sum(asked != provider for asked in self._unanswered)
            for name in [name for name, asked in self._running.items() if asked != provider]:
                self._report(name, "lost")
            for _ in range(refused):
                self._report("", "rejected")

    def _report(self, name: str, status: str, message: Message = None) -> None:
        with self._lock:
            if status == "accepted" and self._unanswered:
                self._running[name] = self._unanswered.popleft()
            elif status == "rejected" and self._unanswered:
                self._unanswered.popleft()
            elif status in _GOAL_ENDS:
                self._running.pop(name, None)
            self._give({"goal_id": name, "status": status} if message is None else message)

    def _provider(self) -> object:
        """Return what identifies the provider of a connection, as long as it goes on."""
        gaps, state = self._connection.gaps, self._connection.state
        is_waiting = state is ConnectionState.WAITING
        return len(gaps), gaps[-1].time if gaps else 0.0, is_waiting


class OfferedFunction:
    """Opens one offer, and holds all that is open for it. One thread opens and closes it.

    A connection goes on behind its handle when a provider dies, so that what is open in the
    framework stays as it is; the next provider emits and takes what the first one did. Calls of
    a service are proven again where another candidate answers them.
    """

    def __init__(self, offer: Offer, functions: Functions, bridge: Bridge, clock: Clock) -> None:
        self.offer = offer
        self.bridge = bridge
        self.calls = 0
        self.failed = 0
        self._functions = functions
        self._clock = clock
        # Guards the counters: a framework calls in several threads.
        self._counting = threading.Lock()
        self._connections: list[Any] = []
        self._channels: list[Channel] = []
        self._routes: list[Route] = []
        self._goals: _GoalWatch | None = None
        self._proofs: dict[int, tuple[Plan, _ServiceProof]] = {}

    @property
    def connections(self) -> tuple[str, ...]:
        """Ids of the connections behind it."""
        return tuple(connection.id for connection in self._connections)

    @property
    def broken(self) -> str | None:
        """Why a connection behind it has ended that should not have; None while there is none."""
        for connection in self._connections:
            is_killed = connection._is_killed  # noqa: SLF001 - the manager's own
            if connection.ended and (connection.state is ConnectionState.FAILED or is_killed):
                return str(connection.cause or "its connection was killed")
        return None

    @property
    def finished(self) -> str | None:
        """Why nothing more will come: the sources of all its connections have finished."""
        ended = [connection.cause for connection in self._connections if connection.ended]
        return str(ended[-1]) if ended and len(ended) == len(self._connections) else None

    def provider_changed(self) -> None:
        """Take in that a provider behind it died or was replaced."""
        if self._goals is not None:
            self._goals.look()

    def open(self) -> None:
        """Request the function and open every port; where one fails, nothing stays open.

        Raises:
            UoarmError: the function cannot be had, or does not fit, or the bridge refuses.
        """
        with on_failure(self.close):
            if self.offer.service is not None:
                self._open_service(self.offer.service)
            else:
                self._open_streams()

    def routes(self) -> tuple[RouteStatus, ...]:
        """Return the counters of what goes out to the framework and comes in from it."""
        return tuple(route.status() for route in self._routes.copy())

    def close(self) -> None:
        """Close all that is open; failures are logged. Bounded in time, and idempotent."""
        for channel in self._channels:
            try:
                channel.close(timeout=_CLOSE_SECONDS)
            except BridgeError as error:
                _log.warning("%s", error)
        for connection in self._connections:
            connection.kill()
        for route in self._routes:
            route.close()

    def _open_streams(self) -> None:
        offer = self.offer
        for port in offer.outputs:
            self._connections.append(self._functions.request(_reference(offer, port.name)))
        if not offer.outputs:
            name = _any_output(offer, self._functions.resolve(offer.function))
            self._connections.append(self._functions.request(name))
            if self._connections[0].output is not None:  # no consumer takes its messages
                self._connections[0].subscribe(_pass_over)
        for port, connection in zip(offer.outputs, self._connections, strict=False):
            self._open_output(port, connection)
        for port in offer.inputs:
            self._open_input(port, self._connections[0])

    def _open_output(self, port: OfferedPort, connection: Any) -> None:
        step, output = connection.plan.provider, connection.output
        if output is None:
            raise ResolutionError(f"function {self.offer.function!r} has no output to offer")
        given = step.structures[f"output.{output}"]
        description = self.bridge.describe(port.endpoint, timeout=_DESCRIBE_SECONDS)
        settled = _settled(port.declared, description.message, given, port.mapping)
        taken = description.limited(settled)
        place = f"{self.offer.name}.{port.name}"
        adapted = _proven(
            f"output {output!r} does not fit {list(port.endpoint.address)}",
            Edge(step.component.name, output, self.offer.name, port.name, given, taken,
                 port.mapping, port.allow_loss),
            port.meaning,
        )  # fmt: skip
        sink = self.bridge.open_sink(port.endpoint, taken, timeout=_OPEN_SECONDS)
        self._channels.append(sink)
        hand: Callable[[Message], None] = sink.send
        if output == _STATUS and any(port.name == _GOAL for port in self.offer.inputs):
            self._goals = _GoalWatch(self._connections[0], sink.send)
            hand = self._goals.report
        queue = port.queue or (sink.default_queue if sink.blocking else None)
        route = Route(connection.id, place, hand, clock=self._clock, transfer=adapted, queue=queue)
        self._routes.append(route)
        connection.subscribe(route.deliver)

    def _open_input(self, port: OfferedPort, connection: Any) -> None:
        step = connection.plan.provider
        free = [port.name for port in step.component.inputs if port.source is None]
        name = free[0] if port.name == "default" and len(free) == 1 else port.name
        if name not in free:
            has = f"has the inputs {', '.join(free)}" if free else "has none"
            raise ResolutionError(
                f"function {self.offer.function!r} has no input {port.name!r} that an "
                f"application feeds: component {step.component.name!r} {has}"
            )
        taken = step.structures[f"input.{name}"]
        said = self.bridge.describe(port.endpoint, timeout=_DESCRIBE_SECONDS).message
        given = _settled(port.declared, said, taken, port.mapping)
        adapted = _proven(
            f"{list(port.endpoint.address)} does not fit the input {name!r}",
            Edge(self.offer.name, port.name, step.component.name, name, given, taken,
                 port.mapping, port.allow_loss),
            port.meaning,
        )  # fmt: skip

        def send(message: Message) -> None:
            connection.send(message, name)

        if name == _GOAL and self._goals is not None:
            send = self._goals.send

        place = f"{self.offer.name}.{port.name}"
        route = Route(place, connection.id, send, clock=self._clock, transfer=adapted)
        self._routes.append(route)
        outlet = Outlet()
        outlet.retain(False)
        outlet.attach(route)
        source = self.bridge.open_source(port.endpoint, given, outlet, timeout=_OPEN_SECONDS)
        self._channels.append(source)

    def _open_service(self, service: OfferedService) -> None:
        plan = self._functions.resolve(self.offer.function)
        proof = self._proof(service, plan)
        self._channels.append(
            self.bridge.serve(
                service.endpoint,
                partial(self._answer, service),
                proof.structures,
                timeout=_OPEN_SECONDS,
            )
        )

    def _answer(self, service: OfferedService, message: Message) -> Message:
        """Answer one caller; what goes wrong is counted, and the bridge informs the caller."""
        try:
            proof = self._proof(service, self._functions.resolve(self.offer.function))
            asked = message if proof.request is None else proof.request(message)
            reply = self._functions.call(self.offer.function, asked, timeout=service.timeout)
            reply = reply if proof.reply is None else proof.reply(reply)
        except BaseException:
            with self._counting:
                self.failed += 1
            raise
        with self._counting:
            self.calls += 1
        return reply

    def _proof(self, service: OfferedService, plan: Plan) -> _ServiceProof:
        found = self._proofs.get(id(plan))
        if found is None:
            if len(self._proofs) >= _KEPT_PROOFS:
                self._proofs.clear()
            found = plan, _ServiceProof(self.offer, service, plan, self.bridge)
            self._proofs[id(plan)] = found  # with the plan, whose id nothing else has meanwhile
        return found[1]


def offered_structures(offer: Offer, bridge: Bridge) -> dict[str, MessageStructure]:
    """Return what an offer has in its framework, by the role and the name of each port.

    A service has `request` and `reply`. What neither the configuration nor the bridge knows takes
    the function's own structure, and is left out.

    Raises:
        BridgeError: the bridge does not describe it.
    """
    found: dict[str, MessageStructure | None] = {}
    for port in (*offer.outputs, *offer.inputs):
        said = bridge.describe(port.endpoint, timeout=_DESCRIBE_SECONDS).message
        found[f"{port.endpoint.role.value}.{port.name}"] = port.declared or said
    if offer.service is not None:
        described = bridge.describe(offer.service.endpoint, timeout=_DESCRIBE_SECONDS)
        found["request"] = offer.service.request or described.request
        found["reply"] = offer.service.reply or described.reply
    return {port: known for port, known in found.items() if known is not None}


def _pass_over(message: Message) -> None:
    """Take a message that has no consumer."""


def _reference(offer: Offer, port: str) -> str:
    return offer.function if port == "default" else f"{offer.function}.{port}"


def _any_output(offer: Offer, plan: Plan) -> str:
    component = plan.provider.component
    if component.service is not None:
        raise ResolutionError(f"function {offer.function!r} has a service and no streams")
    if component.output(None) is not None or not component.outputs:
        return offer.function
    return f"{offer.function}.{component.outputs[0].name}"


def _settled(
    declared: MessageStructure | None,
    said: MessageStructure | None,
    ours: MessageStructure,
    mapping: Mapping[str, object] | None,
) -> MessageStructure:
    """Return the structure in the framework; one that knows of none takes the function's own."""
    known = declared or said
    if known is None and mapping is not None:
        raise ResolutionError(
            "there is a map, and the bridge knows no structure to map to or from: declare it"
        )
    return known or ours


def _proven(what: str, edge: Edge, meaning: Meaning) -> Transfer | None:
    """Return the adapter of an edge, None where messages pass unchanged.

    Raises:
        ResolutionError: not every message fits, or means something else; the text says why, and
            what would mend it.
    """
    verdict = check_edge(
        edge.producer_structure, edge.consumer_structure, edge.mapping, edge.losses, meaning
    )
    if not verdict.compatible:
        reasons = [line for reason in verdict.reasons for line in format_reason(reason)]
        raise ResolutionError("\n  ".join([what, *reasons]))
    return transfer(edge)
