"""The raw steps that a bridge supplies, which the final methods of `Bridge` call.

A bridge must override `_open_source`, `_open_sink` and `_close`. It may override `_describe` and,
where its capabilities say so, must override `_discover`, `_call`, `_serve`, `_link`, `_stop_all`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

from uoarm.bridge._channel import Channel, Sink, Source
from uoarm.bridge._description import Description, Discovered, ServiceStructures
from uoarm.bridge._gate import Delivery
from uoarm.model import Endpoint, Message, MessageStructure, StopOutcome

__all__ = ["ANYTHING", "BridgeSteps", "Handler"]

Handler = Callable[[Message], Message]
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
        failed or is gone, and end within `timeout` seconds. May run in several threads at once.
        """
        raise NotImplementedError

    def _keeps_time(self, endpoint: Endpoint) -> bool:
        """Say whether `_call` of this endpoint ends within its time whatever the framework does.

        May be overridden. The call is then made in the caller's thread, which saves two changes of
        thread, and no limit ends it: nothing in it may wait for longer than the time it is given,
        neither for a lock, nor for a line to take octets, nor in foreign code. It must raise
        BridgeTimeoutError when the time is over. Must itself return at once.
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

    def _link(self, source: Endpoint, sink: Endpoint) -> Channel | None:
        """Connect two endpoints natively; with the capability `link`.

        Must be overridden where the capability is there. May return None for a pair that cannot be
        linked: the manager then moves the messages itself.
        """
        raise NotImplementedError

    def _stop_all(self, release: bool, timeout: float) -> tuple[StopOutcome, ...]:  # noqa: FBT001
        """Stop everything that moves, or release it; with the capability `stop`.

        Must be overridden where the capability is there. Must return what is true of each input,
        with names as this bridge's side has them; nothing where it may not.
        """
        raise NotImplementedError
