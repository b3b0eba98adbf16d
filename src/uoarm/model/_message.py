"""Messages: their structures, the memory that they take, and the queues that they wait in."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from enum import Enum
from functools import cached_property
from itertools import islice
from sys import getsizeof
from typing import Any, TypeAlias

from attrs import field, frozen
from attrs.validators import ge, gt

from uoarm._arguments import built_with_arguments
from uoarm._mistakes import choose
from uoarm._raised import contained
from uoarm.errors import ConfigurationError

Message: TypeAlias = Any
"""A value of the JSON data model, plus `bytes`-like octets and numeric buffers (numpy, array)."""

Schema: TypeAlias = Mapping[str, object] | bool
"""A JSON Schema of draft 2020-12; treated as immutable everywhere."""

Options: TypeAlias = Mapping[str, object]
"""Named settings from the configuration file, already plain JSON values."""

Deliver: TypeAlias = Callable[[Message], None]
"""Takes one message; never raises, never blocks longer than its declared policy."""


def closed_object(
    properties: Mapping[str, Any], required: Iterable[str] | None = None, **more: object
) -> dict[str, Any]:
    """Return the schema of objects with these members and no others; all are required by default.

    Args:
        properties: the schemas of the members.
        required: the names of those that each object has.
        more: further keywords, with `_` for `-`.
    """
    return {
        "type": "object",
        "properties": dict(properties),
        "required": list(properties if required is None else required),
        "additionalProperties": False,
        **{name.replace("_", "-"): value for name, value in more.items()},
    }


@frozen(slots=False, eq=False)
class MessageStructure:
    """The structure of the messages of one port.

    Attributes:
        schema: JSON Schema 2020-12 of the logical value (octets are arrays of 0 to 255).
        native_type: the framework's own name of the type, empty where it has none.

    Two structures are equal when their schemas and native types are equal as JSON.
    """

    schema: Schema
    native_type: str = field(default="", kw_only=True)

    @cached_property
    def fingerprint(self) -> str:
        """A short name of the content: equal for equal structures, on every machine."""
        text = _text([self.schema, self.native_type])
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    @property
    def is_recorded(self) -> bool:
        """Whether its messages are played from a recording."""
        return isinstance(self.schema, Mapping) and "x-recorded" in self.schema

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MessageStructure):
            return NotImplemented
        return self is other or self.fingerprint == other.fingerprint

    def __hash__(self) -> int:
        return hash(self.fingerprint)


def _text(value: Any) -> str:
    try:
        return json.dumps(value, sort_keys=True, separators=(",", ":"))
    except ValueError as error:  # Python writes whole numbers of 4,300 digits at most in tens
        try:
            return json.dumps(_in_hex(value), sort_keys=True, separators=(",", ":"))
        except RecursionError:  # a part of itself
            raise error from None


def exact(mapping: Mapping[str, object] | None) -> str:
    """Return by what to compare: 1, 1.0 and true are equal to Python, and none is the others."""
    if not mapping:
        return "" if mapping is None else "{}"
    try:
        return _text(dict(mapping))
    except TypeError:  # not from a file
        return repr(mapping)


def _in_hex(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {name: _in_hex(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_in_hex(part) for part in value]
    return {"x": hex(value)} if value.__class__ is int else value


class OverflowPolicy(Enum):
    """What happens to a message that finds the queue full; every loss is counted."""

    LATEST = "latest"
    DROP_OLDEST = "drop-oldest"
    BLOCK = "block"


def _policy(name: OverflowPolicy | str) -> OverflowPolicy:
    return choose(OverflowPolicy, name, "policy", ConfigurationError)


@built_with_arguments
@frozen
class QueuePolicy:
    """Length and overflow policy of one queue.

    Attributes:
        length: messages held at most; `latest` always holds one.
        policy: `latest` keeps the newest only, `drop-oldest` makes room at the old end,
            `block` makes the producer wait. Its name does, too; an unknown one is a
            ConfigurationError.
        timeout: seconds that `block` waits before the new message is dropped and counted.
        octets: memory that the messages may hold, as decoded values; with more the queue counts as
            full. One message of any size passes when it is alone.
    """

    length: int = field(default=16, validator=ge(1))
    policy: OverflowPolicy = field(default=OverflowPolicy.DROP_OLDEST, converter=_policy)
    timeout: float = field(default=1.0, validator=gt(0.0))
    octets: int = field(default=67_108_864, validator=ge(1))


class ValidationMode(Enum):
    """How many messages of a connection are checked against their declared structure."""

    OFF = "off"
    SAMPLED = "sampled"
    ALWAYS = "always"

    __hash__ = object.__hash__  # members are singletons; by name it costs ten times as much


_FLAT = {int, float, bool, type(None), str, bytes}
_MANY = 32
_COUNTED_AT_EACH = 100_000


MOST_OCTETS = 2**30
"""Of one message in any form: an array that repeats its values may say that it has more."""
_MOST_CLAIMED = 2**24


def elements_of(value: Any) -> list[Any] | tuple[Any, ...]:
    """Return the elements of what has a length, in a list or tuple that no other thread changes.

    Raises:
        ValueError: it gives more elements than it says, without an end perhaps, or fewer.
    """
    kind = type(value)
    if kind is tuple:
        elements: tuple[Any, ...] = value
        return elements
    return value[:] if kind is list else _counted(value, len(value))


def items_of(value: Mapping[Any, Any]) -> dict[Any, Any]:
    """Return the items of a mapping in a dict that no other thread changes.

    Raises:
        ValueError: as by `elements_of`.
    """
    return value.copy() if type(value) is dict else dict(_counted(value.items(), len(value)))


def plain_copy(value: Any, leaf: Callable[[Any], Any] | None = None) -> Any:
    """Return a value whose mappings and lists are Python's own: others may never come to an end.

    Args:
        value: any value.
        leaf: makes what is neither a mapping nor a list; without it that stays as it is.

    Raises:
        ValueError: as by `elements_of`; what the value's own methods, or `leaf`, raise passes.
    """
    if type(value) in _FLAT:  # as most are, and a test for a mapping costs several times as much
        return value if leaf is None else leaf(value)
    if isinstance(value, Mapping):
        return {key: plain_copy(item, leaf) for key, item in items_of(value).items()}
    if isinstance(value, list | tuple):
        elements = elements_of(value)
        if set(map(type, elements)) <= _FLAT:
            return elements if leaf is None else [*map(leaf, elements)]
        return [plain_copy(element, leaf) for element in elements]
    return value if leaf is None else leaf(value)


def array_as_lists(value: Any) -> Any:
    """Return an array, or a scalar, of numpy with values of Python; anything else as it is.

    Raises:
        ValueError: it says that it has more than `MOST_OCTETS`.
    """
    if not hasattr(value, "tolist") or isinstance(value, memoryview):
        return value
    if (octets := memoryview(value).nbytes) > MOST_OCTETS:  # its values repeat, perhaps
        raise ValueError(f"an array of {octets:,} octets: {MOST_OCTETS:,} are allowed")
    return plain_copy(value.tolist())  # of objects, perhaps


def _counted(values: Iterable[Any], size: int) -> list[Any]:
    if size > _MOST_CLAIMED:
        raise ValueError(f"it has {size:,} elements: {_MOST_CLAIMED:,} are allowed")
    found = list(islice(values, size + 1))
    if len(found) != size:
        others = "more" if len(found) > size else f"{len(found):,}"
        raise ValueError(f"it says that it has {size:,} elements, and gives {others}")
    return found


def message_octets(message: Message, *, most: int | None = None) -> int:
    """Return how many octets of memory a message holds: its decoded values, with their containers.

    An estimate on the safe side: what several places share (a name, a small number) is counted at
    each, until a hundred thousand values, as one within itself has no end; of an object beyond the
    data model only what it says of itself. Never raises, never recurses, linear in the number of
    values; a buffer is one value, and long lists of numbers or texts are counted at the speed of C.

    Args:
        message: any value of the data model, with octets and numeric buffers.
        most: counting stops when this is passed; the result is then some number above it.
    """
    octets, left = 0, _COUNTED_AT_EACH
    waiting: list[Any] = [message]
    seen: set[int] = set()
    while waiting:
        value = waiting.pop()
        kind = type(value)
        try:
            octets += getsizeof(value)
            if most is not None and octets > most:
                break  # before the values of a long list are even looked at
            if kind in _FLAT:
                continue
            inner: Any = ()
            if kind is dict or isinstance(value, Mapping):
                octets += sum(map(getsizeof, value))
                inner = value.values()
            elif isinstance(value, list | tuple):
                if len(value) > _MANY and set(map(type, value)) <= _FLAT:
                    octets += sum(map(getsizeof, value))
                else:
                    inner = value
            elif isinstance(size := getattr(value, "nbytes", None), int):
                octets += max(size - getsizeof(value), 0)  # what a view or a numpy array stands for
            left -= len(inner)
            if left < 0 and inner:
                if id(value) in seen:
                    continue
                seen.add(id(value))
            waiting.extend(inner)
        except BaseException as error:  # noqa: BLE001 - of its methods, or it changes meanwhile
            contained(error)
    return octets
