"""A catalogue over bridges: each endpoint is described once, until it is forgotten."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Container, Iterator, Mapping
from functools import lru_cache, partial
from typing import Any, Protocol, TypeAlias

from attrs import define, field, frozen

from uoarm._support import deadlines
from uoarm.bridge import Bridge, Description
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import Component, Endpoint, Meaning, MessageStructure, Reason
from uoarm.schema import UnsupportedPatternError, check, found_in


@frozen
class Unavailable:
    """Why a component's structures cannot be had now."""

    sentence: str


@frozen
class Structures:
    """The structures of a component's ports by name, and what a reader should know of them.

    `managers` are those through which its messages pass, as bridges say.
    """

    by_port: Mapping[str, MessageStructure]
    warnings: tuple[str, ...] = ()
    managers: tuple[str, ...] = ()


class StructureCatalogue(Protocol):
    """Knows the structures of components."""

    def structures(self, component: Component) -> Structures | Unavailable:
        """Return structures keyed `input.NAME`, `output.NAME`, or `request` and `reply`."""


class Judgement(Protocol):
    """The verdict on one edge."""

    @property
    def compatible(self) -> bool:
        """Whether every message of the producer is accepted."""

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """Why not, when it is not."""

    @property
    def losses(self) -> tuple[str, ...]:
        """Fields that are dropped on the way, all of them allowed by name."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a careful reader should know."""

    @property
    def unstated(self) -> tuple[str, ...]:
        """Paths of what fits in shape, of whose meaning one side says nothing."""


EdgeCheck: TypeAlias = Callable[
    [
        MessageStructure,
        MessageStructure,
        "Mapping[str, object] | None",
        "tuple[str, ...]",
        Meaning,
    ],
    Judgement,
]


_DESCRIBE_SECONDS = 30.0
_OF_SERVICES = ("request", "reply")

Hold: TypeAlias = Callable[[Component, Structures], "Structures | Unavailable"]
"""Says whether structures may be used: what it returns takes their place."""


@define(eq=False)
class _Entry:
    """What is known of one component, asked for by one caller at a time."""

    asking: threading.Lock = field(factory=threading.Lock)
    found: Structures | None = None
    is_hanging: bool = False


class StructureCache:
    """Asks bridges for structures and remembers what they said. Thread safe.

    What a bridge could not say is asked again the next time, unless it hangs still.

    Args:
        bridge: gives the bridge instance of a name; may raise what starting one raises.
        hold: asked about what bridges said, each time anew; None: all of it may be used.
    """

    def __init__(self, bridge: Callable[[str], Bridge], hold: Hold | None = None) -> None:
        self._bridge = bridge
        self._hold = hold
        self._entries: dict[str, _Entry] = {}
        self._lock = threading.Lock()

    def structures(self, component: Component) -> Structures | Unavailable:
        """Return the structures of a component's ports, or why they cannot be had."""
        found = self._known(component)
        if self._hold is None or isinstance(found, Unavailable):
            return found
        return self._hold(component, found)

    def _known(self, component: Component) -> Structures | Unavailable:
        with self._lock:
            entry = self._entries.setdefault(component.name, _Entry())
        if entry.found is not None:
            return entry.found
        with entry.asking:
            if entry.found is None:
                if entry.is_hanging:
                    text = f"bridge {component.bridge!r} has not answered what was asked before"
                    return Unavailable(text)
                # Its bridge starts and answers within limits of its own. One that does not is no
                # reason to give up a request for which another component may do.
                ask = partial(self._ask_once, component, entry)
                try:
                    entry.found = deadlines.run(
                        f"asking for {component.name}", math.inf, ask, isolated=True
                    )
                except (_UnknownError, UoarmError) as error:
                    return Unavailable(str(error))
            return entry.found

    def _ask_once(self, component: Component, entry: _Entry) -> Structures:
        # Not by who waits, which may give it up in the very moment in which it is over.
        entry.is_hanging = True
        try:
            return self._ask(component)
        finally:
            entry.is_hanging = False

    def forget(self, component: str) -> None:
        """Ask again the next time.

        An answer that is under way goes to the callers that wait for it only: it lands in
        an entry that is no longer listed.
        """
        with self._lock:
            self._entries.pop(component, None)

    def carried_over(
        self, bridge: Callable[[str], Bridge], without: Container[str], hold: Hold | None = None
    ) -> StructureCache:
        """Return a cache that knows what this one does, but for some components."""
        made = StructureCache(bridge, hold)
        with self._lock:
            known = {
                name: entry.found for name, entry in self._entries.items() if name not in without
            }
        made._entries = {name: _Entry(found=found) for name, found in known.items()}
        return made

    def use(self, bridge: Callable[[str], Bridge]) -> None:
        """Ask other bridges from now on."""
        self._bridge = bridge

    def _ask(self, component: Component) -> Structures:
        found: dict[str, MessageStructure] = {}
        warnings: list[str] = []
        managers: dict[str, None] = {}

        def settle(
            name: str, part: str, description: Description, declared: MessageStructure | None
        ) -> None:
            managers.update(dict.fromkeys(description.managers))
            said: MessageStructure | None = getattr(description, part)
            if declared is not None:
                found[name] = declared
                if said is not None:
                    warnings.append(
                        f"{component.name}.{name}: the declared structure replaces the bridge's"
                    )
            elif said is not None:
                found[name] = _proper(said, f"bridge {component.bridge!r}: structure {name!r}")
            else:
                key = name if name in _OF_SERVICES else "structure"
                hint = f"{description.hint}, or " if description.hint else ""
                raise _UnknownError(
                    f"the structure of {name!r} is not known to bridge {component.bridge!r}: "
                    f"{hint}declare it in the configuration, as `{key}` beside its `endpoint`"
                )
            if name == "request" or name.startswith("input."):
                found[name] = description.limited(found[name])

        fed = {port.endpoint.address for port in component.inputs}
        for role, ports in (("input", component.inputs), ("output", component.outputs)):
            for port in ports:
                description = self._describe(port.endpoint)
                if description.note:
                    warnings.append(f"{component.name}.{role}.{port.name}: {description.note}")
                if wrong := description.unfed(port.endpoint.address, fed):
                    raise BridgeError(wrong, FailureReason.BAD_ENDPOINT)
                settle(f"{role}.{port.name}", "message", description, port.declared)
        if component.service is not None:
            service = component.service
            description = self._describe(service.endpoint)
            if description.note:
                warnings.append(f"{component.name}: {description.note}")
            settle("request", "request", description, service.request)
            settle("reply", "reply", description, service.reply)
        return Structures(found, tuple(warnings), tuple(managers))

    def _describe(self, endpoint: Endpoint) -> Description:
        return self._bridge(endpoint.bridge).describe(endpoint, timeout=_DESCRIBE_SECONDS)


def _proper(structure: MessageStructure, place: str) -> MessageStructure:
    """Return a structure of which every edge, check and lock can take the schema for one."""
    try:
        _read_whole(structure)
    except (TypeError, ValueError, RecursionError) as error:
        text = f"{place} cannot be used: {error}"
        raise BridgeError(text, FailureReason.CONTRACT) from error
    return structure


@lru_cache(maxsize=1024)
def _read_whole(structure: MessageStructure) -> None:
    check(structure.schema, structure.schema)
    for pattern in _patterns(structure.schema):
        try:
            found_in(pattern, "")
        except UnsupportedPatternError as error:
            # Messages are searched for it with Python's `re`, which its author can have search for
            # years. What the configuration declares is the owner's own.
            hint = "the configuration may declare the structure"
            text = f"the pattern {pattern!r:.80} is not decided here: {error}; {hint}"
            raise ValueError(text) from None


def _patterns(schema: Any) -> Iterator[str]:
    """Give the patterns of a schema; also what only looks so, in a constant."""
    waiting = [schema]
    while waiting:
        value = waiting.pop()
        if isinstance(value, Mapping):
            if isinstance(pattern := value.get("pattern"), str):
                yield pattern
            if isinstance(named := value.get("patternProperties"), Mapping):
                yield from named
            waiting += value.values()
        elif isinstance(value, list | tuple):
            waiting += value


class _UnknownError(Exception):
    """A structure that neither the bridge nor the configuration gives."""
