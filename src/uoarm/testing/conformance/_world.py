"""What a bridge author supplies: a bridge, components to play with, and ways to harm them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

from attrs import frozen

from uoarm.bridge import Bridge
from uoarm.model import Endpoint, Message
from uoarm.testing._patience import patience

__all__ = ["Pair", "Served", "Victim", "World"]


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
class Served:
    """A service in the framework.

    Attributes:
        endpoint: where it is.
        request: a request that it answers.
        reply: its answer.
        failing: a service that fails on every request; None where there is no such thing.
        silent: a service that answers no request in time; None where there is no such thing.
    """

    endpoint: Endpoint
    request: Message
    reply: Message
    failing: Endpoint | None = None
    silent: Endpoint | None = None


class World(ABC):
    """The framework as the suite sees it, made anew for each test.

    Must implement: `bridge`, `pair`, `missing`. What else is not overridden is not tested, and
    the test says that it was skipped and why.
    """

    @property
    def patience(self) -> float:
        """Seconds that a message, or the news of a death, may take at most."""
        return patience()

    @abstractmethod
    def bridge(self) -> Bridge:
        """Return a new bridge to this world; the test closes it. May be called several times."""

    @abstractmethod
    def pair(self, kind: str) -> Pair:
        """Return the pair of one of the test class's `kinds`, the same for every call."""

    @abstractmethod
    def missing(self) -> Endpoint:
        """Return a well-formed output endpoint that is not there."""

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

    def served(self) -> Served | None:
        """Return a service; None for a bridge that cannot call."""
        return None

    def servable(self) -> tuple[Endpoint, Endpoint] | None:
        """Return where a function can be served, and where a client then calls it."""
        return None

    def linkable(self) -> Pair | None:
        """Return two endpoints that the bridge can link; `source` feeds `sink`."""
        return None
