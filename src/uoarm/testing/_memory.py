"""A second bridge in memory: typed on both sides, and as unlike the `python` bridge as possible.

Where it is kinder than reality: nothing is lost on the way, a message arrives in the thread that
emitted it, and a component dies only when a test says so.
"""

from __future__ import annotations

from typing import TypeVar

from uoarm._arguments import arguments
from uoarm._spelling import did_you_mean
from uoarm.bridge import (
    Bridge,
    Capabilities,
    Channel,
    DeclaredOptions,
    Delivery,
    Description,
    Discovered,
    Handler,
    NativeLink,
    ServiceStructures,
    Sink,
    Source,
)
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Deliver, Endpoint, Health, Message, MessageStructure, Options, Role, Schema
from uoarm.testing._components import (
    CLEARED,
    PAIRS,
    ROWS,
    Emitter,
    Loop,
    MemoryService,
    Taker,
    codec,
)

_Component = TypeVar("_Component", Emitter, Taker, Loop, MemoryService)


class MemoryBridge(Bridge):
    """Components that a test plays on, behind native conversion on both sides.

    An endpoint's address is one string, the name under which the test made the component with
    `emitter`, `taker`, `loop` or `service`. Producers keep their messages as rows, consumers
    take them as pairs (`PAIRS`), and each is opened only with its own structure.

    Args:
        name: name of this instance.
        options: none are known.
        links: whether it connects two of its own endpoints natively.
    """

    @arguments()
    def __init__(
        self,
        name: str = "memory",
        options: Options | DeclaredOptions | None = None,
        *,
        links: bool = False,
    ) -> None:
        super().__init__(name, options or {})
        self.capabilities = Capabilities(discover=True, call=True, serve=True, link=links)
        self._components: dict[str, Emitter | Taker | Loop | MemoryService] = {}
        self._is_cut = ""

    def emitter(self, name: str, schema: Schema, *, latched: bool = False) -> Emitter:
        """Make a component with one output, from which the test emits.

        One that is `latched` hands its last message to each source that is opened.
        """
        structure = MessageStructure(schema, native_type=f"{name}/Row")
        return self._add(name, Emitter(structure, latched=latched))

    def taker(self, name: str, schema: Schema, *, blocking: bool = False) -> Taker:
        """Make a component with one input, whose messages the test reads."""
        structure = MessageStructure(schema, native_type=f"{name}/Pairs")
        return self._add(name, Taker(structure, blocking=blocking))

    def loop(self, name: str, schema: Schema) -> Loop:
        """Make a component that emits what it takes: one input and one output."""
        return self._add(name, Loop(MessageStructure(schema, native_type=f"{name}/Loop")))

    def service(self, name: str, request: Schema, reply: Schema, handler: Handler) -> MemoryService:
        """Make a component with a service that the test's function answers."""
        return self._add(
            name, MemoryService(MessageStructure(request), MessageStructure(reply), handler)
        )

    def cut(self, cause: str = "the link was cut") -> None:
        """Break the link to all components: nothing passes until `mend`, and that is reported."""
        self._is_cut = cause
        for name in tuple(self._components):
            self._report_at(name, self._components[name], Health.DEGRADED, cause)

    def mend(self) -> None:
        """Mend the link: the channels that are open go on."""
        self._is_cut = ""
        for name in tuple(self._components):
            self._report_at(name, self._components[name], Health.OK, "the link is there again")

    def die(self, name: str, cause: str = "the component was killed") -> None:
        """Let a component be gone: its channels are lost and it can be found no more."""
        self._report_at(name, self._components.pop(name), Health.LOST, cause)

    def _add(self, name: str, component: _Component) -> _Component:
        if name in self._components:
            raise ValueError(f"there is a component {name!r} already")
        self._components[name] = component
        return component

    def _describe(self, endpoint: Endpoint) -> Description:
        if endpoint.is_offered and endpoint.role is Role.SERVICE:
            return Description()
        component = self._find(endpoint)
        if isinstance(component, MemoryService):
            return Description(request=component.request, reply=component.reply)
        return Description(component.structure)

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Deliver | Delivery
    ) -> Source:
        component = self._find(endpoint)
        if not isinstance(component, (Emitter, Loop)):
            raise _without(endpoint, "output")
        _same(endpoint, component.structure, structure)
        read = codec(structure.schema, ROWS).read

        def take(row: object, writer: str = "") -> None:
            if self._is_cut:
                return
            if row is CLEARED:
                if isinstance(deliver, Delivery):
                    deliver.let_go(writer)
                return
            try:
                message = read(row)
            except BridgeError as error:
                if isinstance(deliver, Delivery):
                    deliver.unreadable(str(error))
            else:
                if writer and isinstance(deliver, Delivery):
                    deliver(message, writer)
                else:
                    deliver(message)

        channel = Source(endpoint, lambda: component.leave(channel), latched=component.latched)
        component.join(channel, take)
        return channel

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        component = self._find(endpoint)
        if not isinstance(component, (Taker, Loop)):
            raise _without(endpoint, "input")
        _same(endpoint, component.structure, structure)
        write = codec(structure.schema, PAIRS).write

        def send(message: Message) -> None:
            self._require_link()
            component.take(write(message))

        sink = Sink(endpoint, send, lambda: component.leave(sink), blocking=component.blocking)
        component.join(sink, None)
        return sink

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        del timeout
        component = self._find(endpoint)
        if not isinstance(component, MemoryService):
            raise _without(endpoint, "service")
        if structures != ServiceStructures():
            _same(endpoint, component.request, structures.request)
            _same(endpoint, component.reply, structures.reply)
        return component.answer(message)

    def _serve(
        self, endpoint: Endpoint, structures: ServiceStructures, handler: Handler
    ) -> Channel:
        name = endpoint.address[0]
        self._add(name, MemoryService(structures.request, structures.reply, handler))
        return Channel(endpoint, lambda: self._components.pop(name, None))

    def _link(self, source: Endpoint, sink: Endpoint) -> NativeLink | None:
        producer, consumer = self._find(source), self._find(sink)
        if not isinstance(producer, Emitter) or not isinstance(consumer, Taker):
            return None
        read = codec(producer.structure.schema, ROWS).read
        write = codec(consumer.structure.schema, PAIRS).write

        def relay(row: object, _writer: str = "") -> None:
            if not self._is_cut:
                consumer.take(write(read(row)))

        def leave() -> None:
            producer.leave(link)
            consumer.leave(link)

        link = NativeLink(source, sink, leave)
        producer.join(link, relay)
        consumer.join(link, None)
        return link

    def _discover(self) -> tuple[Discovered, ...]:
        return tuple(
            Discovered(
                name,
                tuple((endpoint, self._describe(endpoint)) for endpoint in self._endpoints(name)),
            )
            for name in self._components
        )

    def _close(self) -> None:
        self._components.clear()

    def _report_at(
        self,
        name: str,
        component: Emitter | Taker | Loop | MemoryService,
        health: Health,
        cause: str,
    ) -> None:
        """Report it of what is open at a component; of a link, of its end there."""
        channels = () if isinstance(component, MemoryService) else component.channels()
        for channel in channels:
            sink = channel.sink if isinstance(channel, NativeLink) else None
            end = sink.component if sink is not None and sink.address == (name,) else None
            self.report(health, cause, channel=channel, component=end)

    def _require_link(self) -> None:
        if self._is_cut:
            raise BridgeError(self._is_cut, FailureReason.UNAVAILABLE)

    def _endpoints(self, name: str) -> tuple[Endpoint, ...]:
        component = self._components[name]
        return tuple(Endpoint(self.name, name, role, (name,)) for role in component.roles)

    def _find(self, endpoint: Endpoint) -> Emitter | Taker | Loop | MemoryService:
        self._require_link()
        name = endpoint.address[0] if len(endpoint.address) == 1 else ""
        component = self._components.get(name)
        if component is None:
            hint = did_you_mean(name, self._components)
            text = f"there is no component at {list(endpoint.address)}{hint}"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        return component


def _without(endpoint: Endpoint, kind: str) -> BridgeError:
    return BridgeError(f"{endpoint} is no {kind}", FailureReason.BAD_ENDPOINT)


def _same(endpoint: Endpoint, own: MessageStructure, given: MessageStructure) -> None:
    """Refuse a structure that is another port's."""
    if own.schema != given.schema:
        text = f"{endpoint} was opened with the structure of {given.native_type or 'another port'}"
        raise BridgeError(text, FailureReason.REFUSED)
