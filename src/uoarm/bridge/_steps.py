"""The raw steps that a bridge supplies, which the final methods of `Bridge` call, and their values.

A bridge must override `_open_source`, `_open_sink` and `_close`. It may override `_describe` and,
where its capabilities say so, must override `_discover`, `_call`, `_serve`, `_link`, `_stop_all`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Container, Mapping
from typing import Any

from attrs import evolve, field, frozen

from uoarm.bridge._border import Delivery
from uoarm.bridge._channel import Channel, NativeLink, Sink, Source
from uoarm.model import Endpoint, Health, Message, MessageStructure, StopOutcome

_ANYTHING = MessageStructure(schema=True)
Handler = Callable[[Message], Message]


@frozen
class Description:
    """The message structures of one endpoint.

    A stream has `message`; a service has `request` and `reply`. None where the framework does
    not know: the configuration must then declare the structure, unless what `hint` says is done.

    Attributes:
        hint: what would have the framework know what it does not: a sentence without a full stop.
        note: what a careful reader of a plan should know of the endpoint, such as what is lost
            there without a word: a sentence without a full stop.
        managers: identities of the managers through which its messages pass, the nearest first.
        limits: keywords that hold of whatever is sent there, also where the configuration declares
            another structure: `x-max-json`, `x-max-octets` and `x-nonfinite: false`.
        needs_input: whether an output emits only for what an input with the same address takes.
    """

    message: MessageStructure | None = None
    request: MessageStructure | None = None
    reply: MessageStructure | None = None
    hint: str = ""
    note: str = ""
    limits: Mapping[str, object] = field(factory=dict, hash=False)
    managers: tuple[str, ...] = ()
    needs_input: bool = False

    def unfed(self, address: tuple[str, ...], inputs: Container[tuple[str, ...]]) -> str:
        """Return why an output would never emit, "" where it may; of the inputs' addresses."""
        if not self.needs_input or address in inputs:
            return ""
        return (
            f"{', '.join(address)} emits only for the messages that it takes, and the component "
            f"has no input there: give it an `input` with the same `endpoint`"
        )

    def limited(self, structure: MessageStructure) -> MessageStructure:
        """Return a structure of what is sent there, with the limits that hold of it."""
        if not self.limits or structure.schema is False:
            return structure
        own: Any = {} if structure.schema is True else structure.schema
        return evolve(structure, schema={**own, **self.limits})


@frozen
class ServiceStructures:
    """What a service takes and answers, as the plan was proven with; anything where not said."""

    request: MessageStructure = _ANYTHING
    reply: MessageStructure = _ANYTHING


@frozen
class Discovered:
    """A component that is visible now, without having been configured.

    Attributes:
        name: as the framework names it.
        endpoints: what can be opened of it.
        detail: what else the framework says of it.
        rates: messages a second that outputs give at most or as promised, by port; only what
            the framework itself states.
    """

    name: str
    endpoints: tuple[tuple[Endpoint, Description], ...]
    detail: str = ""
    rates: Mapping[str, float] = field(factory=dict, hash=False, eq=False)


@frozen
class Capabilities:
    """What a bridge can do, checked when a plan is made and never found out in motion.

    Attributes:
        discover: lists components by itself.
        call: reaches services of components.
        serve: offers a function to the framework as a service.
        link: connects two of its own endpoints without the manager in between.
        stop: an emergency stop here stops everything behind it that moves, by any client.
    """

    discover: bool = False
    call: bool = False
    serve: bool = False
    link: bool = False
    stop: bool = False


@frozen(eq=False)
class HealthEvent:
    """A change for the better or the worse that a bridge noticed by itself.

    Attributes:
        bridge: name of the instance.
        health: what it is now; `Bridge.report` says what the manager does on each.
        cause: why, in one sentence.
        channel: the channel concerned; None when it is the whole bridge or `component`.
        component: the component concerned, of a native link that at one of its ends; None when it
            is the channel's own or the whole bridge.
        about: what of the component was judged, where that is several things; empty for all of it.
    """

    bridge: str
    health: Health
    cause: str
    channel: Channel | None = None
    component: str | None = None
    about: str = ""


ANYTHING = ServiceStructures()


class BridgeSteps(ABC):
    """What a bridge knows how to do in its framework; see `Bridge` for how each step is called."""

    def _describe(self, endpoint: Endpoint) -> Description:
        """Return the endpoint's structures.

        May be overridden; without it every structure must be declared in the configuration. Must
        raise BridgeError with NOT_FOUND or UNAVAILABLE, with a sentence that names it, when
        the endpoint is not there now; with BAD_ENDPOINT when it cannot be. May leave out what the
        framework does not know. Must say the same as long as nothing changes.
        """
        del endpoint
        return Description()

    @abstractmethod
    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        """Open an output.

        Must return only when a message that is emitted from then on will arrive, and raise
        BridgeError when it cannot be opened, with nothing left open. May call `deliver` before it
        returns, from any thread and from several: the core has one message at a time pass, in the
        order in which they come, and none after the channel was closed. `deliver` never raises and
        may take its time. A message that cannot be read must not reach it, nor end the channel:
        say it with `deliver.unreadable(why)`. The core counts it, and judges the component.

        A source that is `latched` says with `deliver(message, writer)` whose a message is where
        several write beside one another, and with `deliver.let_go(writer)` that nothing of it
        stands any more. A parameter of the type `Deliver` will do for any other.
        """

    @abstractmethod
    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        """Open an input.

        Must return only when a message that is sent from then on will arrive, and raise
        BridgeError when it cannot be opened, with nothing left open. Must not wait for a
        `deliver` of another channel that is under way.
        """

    @abstractmethod
    def _close(self) -> None:
        """Let go of the framework: threads, sockets, handles.

        Called once, after every channel was closed, of which some may not have let go. Must not
        wait without limit for a thread that may be in a `deliver`.
        """

    def _discover(self) -> tuple[Discovered, ...]:
        """Return the components that are visible now; with the capability `discover`.

        Must be overridden where the capability is there. Must give endpoints that `_describe`
        then describes as given here. A port whose name begins with `@` is about the component
        itself, such as `@lifecycle`: nothing is made a function of it unasked.
        """
        raise NotImplementedError

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        """Send one request and return its reply; with the capability `call`.

        Must be overridden where the capability is there. Must raise BridgeError when the service
        failed or is gone, and end within `timeout` seconds, and as the bridge is closed: `_close`
        or `cancelling` ends what waits. May run in several threads at once.
        """
        raise NotImplementedError

    def _keeps_time(self, endpoint: Endpoint) -> bool:
        """Say whether `_call` of this endpoint ends within its time whatever the framework does.

        May be overridden. The call is then made in the caller's thread, which saves two changes of
        thread, and no limit ends it: nothing in it may wait for longer than the time it is given,
        neither for a lock, nor for a line to take octets, nor in foreign code, and in steps of
        `wait_step` for a Ctrl-C. It must raise BridgeTimeoutError when the time is over. Must
        itself return at once.
        """
        del endpoint
        return False

    def _is_quick(self, endpoint: Endpoint) -> bool:
        """Say whether `_open_source` or `_open_sink` of this endpoint, and its close, end at once.

        May be overridden. Both are then done in the caller's thread, which saves changes of thread,
        and no limit ends them: nothing in them may wait for the framework, nor for a lock that
        is held by what does, nor run foreign code that may hang. They may still raise. Where
        this is wrong, the caller of a request hangs with no limit; in the main thread Ctrl-C ends
        that when it comes for the second time, as the first waits for the end of the request.
        Must itself return at once.
        """
        del endpoint
        return False

    def _serve(
        self, endpoint: Endpoint, structures: ServiceStructures, handler: Handler
    ) -> Channel:
        """Offer a service to the framework; with the capability `serve`.

        Must be overridden where the capability is there. `handler` may raise an `Exception` and may
        take its time: the caller must then get a failure, and other channels must not wait for it.
        """
        raise NotImplementedError

    def _link(self, source: Endpoint, sink: Endpoint) -> NativeLink | None:
        """Connect two endpoints natively; with the capability `link`.

        Must be overridden where the capability is there. May return None for a pair that cannot be
        linked: the manager then moves the messages itself. Must report each end with its component,
        and a death of the one that died.
        """
        raise NotImplementedError

    def _stop_all(self, release: bool, timeout: float) -> tuple[StopOutcome, ...]:  # noqa: FBT001
        """Stop everything that moves, or release it; with the capability `stop`.

        Must be overridden where the capability is there. Must return what is true of each input,
        with names as this bridge's side has them; nothing where it may not.
        """
        raise NotImplementedError
