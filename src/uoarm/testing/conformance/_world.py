"""What a bridge author supplies: a bridge, components to play with, and ways to harm them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

from attrs import frozen

from uoarm.bridge import Bridge, Registry
from uoarm.model import BridgeSpec, Endpoint, Message
from uoarm.testing._patience import patience

__all__ = ["Pair", "Retained", "Served", "Victim", "World"]


@frozen
class Pair:
    """Two endpoints: what is sent to `sink` comes out of `source`, once and in order."""

    sink: Endpoint
    source: Endpoint


@frozen
class Victim:
    """A component with an output that ends when `kill` is called, as when its process dies."""

    source: Endpoint
    kill: Callable[[], object]


@frozen
class Retained:
    """An output whose last message stands: `emit` has the component emit one and returns it."""

    source: Endpoint
    emit: Callable[[], Message]


@frozen
class Served:
    """A service in the framework.

    Attributes:
        endpoint: where it is.
        request: a request that it answers.
        reply: its answer.
        failing: a service that fails on every request; None where there is no such thing.
        silent: a service that answers no request in time; None where there is no such thing.
        more: further requests to the first service, each with a reply of its own.
    """

    endpoint: Endpoint
    request: Message
    reply: Message
    failing: Endpoint | None = None
    silent: Endpoint | None = None
    more: Sequence[tuple[Message, Message]] = ()


class World(ABC):
    """The framework as the suite sees it, made anew for each test.

    Must implement: `pair`, `missing`, and `spec` or `bridge`. What else is not overridden is not
    tested, and the test says that it was skipped and why.
    """

    @property
    def patience(self) -> float:
        """Seconds that a message, or the news of a death, may take at most."""
        return patience()

    def spec(self) -> BridgeSpec | None:
        """Return the bridge as a configuration has it: name, plugin, options.

        It is what runs in a host where the class of tests says `hosted = True`.
        """
        return None

    def registry(self) -> Registry:
        """Return where the plugin of `spec` is found; those installed, unless overridden."""
        return Registry()

    def bridge(self) -> Bridge:
        """Return a new bridge to this world; the test closes it. May be called several times.

        The one of `spec`, unless overridden.
        """
        spec = self.spec()
        assert spec is not None, f"{type(self).__name__} implements neither `bridge` nor `spec`"
        return self.registry().create(spec)

    @abstractmethod
    def pair(self, kind: str) -> Pair:
        """Return the pair of one of the test class's `kinds`, the same for every call."""

    @abstractmethod
    def missing(self) -> Endpoint:
        """Return a well-formed output endpoint that is not there."""

    def await_receivers(self, kind: str, count: int) -> None:  # noqa: B027 - mostly they are reached
        """Return once what comes out at a pair's source reaches so many receivers.

        Override where a part of this world, such as a node in another process, sends it on and
        learns of a receiver in its own time, of which nobody tells the bridge.
        """

    def carried(self, kind: str, message: Message) -> Message:
        """Return what should come out for a message; override where the framework rounds."""
        del kind
        return message

    def takes(self, kind: str, message: Message) -> bool:
        """Whether a message that the structure allows can be sent.

        Override where the framework has a limit that JSON Schema cannot say, such as one on the
        octets of a text; the suite holds that such a message is refused with a MessageError.
        """
        del kind, message
        return True

    def samples(self, kind: str) -> Sequence[Message]:
        """Return messages to be tried beside the generated ones: NaN, very large, recorded."""
        del kind
        return ()

    def victim(self) -> Victim | None:
        """Return a component that can be killed; None where nothing ever dies alone."""
        return None

    def victims(self) -> Sequence[Victim]:
        """Return several components that can be killed, each alone; none where there are not."""
        return ()

    def broken(self) -> bool:
        """Break what the bridge stands on, as a cable or a broker does; False where nothing can.

        Called while a line of a pair is open, at most once before `mended`.
        """
        return False

    def mended(self) -> None:  # noqa: B027 - nothing to mend
        """Mend what `broken` broke."""

    def unreadable(self, kind: str) -> Callable[[], object] | None:
        """Return what emits a payload that cannot be read at a pair's source; None: there is none.

        The first of the kinds is asked for it.
        """
        del kind
        return None

    def retained(self) -> Retained | None:
        """Return an output whose last message stands; None where the framework has none."""
        return None

    def served(self) -> Served | None:
        """Return a service; None for a bridge that cannot call."""
        return None

    def servable(self) -> tuple[Endpoint, Endpoint] | None:
        """Return where a function can be served, and where a client then calls it."""
        return None

    def linkable(self) -> Pair | None:
        """Return two endpoints that the bridge can link; `source` feeds `sink`."""
        return None
