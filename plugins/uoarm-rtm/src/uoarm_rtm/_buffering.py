"""How connectors keep data that waits: policies as OpenRTM's connector properties name them.

A policy travels as properties whatever side it is for, and is read from them by the side that
holds the buffer: both ways through here.
"""

from __future__ import annotations

from collections.abc import Mapping

from attrs import frozen

__all__ = [
    "POLICY_OPTIONS",
    "BufferPolicy",
    "PushPolicy",
    "buffer_policy",
    "policy_properties",
    "push_policy",
    "says_what_empty_means",
]

POLICY_OPTIONS = ("buffer", "inport_buffer", "outport_buffer", "push_policy", "skip_count")
"""The options of an endpoint that `policy_properties` reads."""

_SIDES = ("inport", "outport")

_FULL = ("overwrite", "do_nothing", "block")
_EMPTY = ("do_nothing", "readback", "block")
_PUSH = ("new", "fifo", "skip", "all")
_PUSH_POLICY = "dataport.publisher.push_policy"
_SKIP_COUNT = "dataport.publisher.skip_count"
_LONGEST = 10_000
_MOST_SECONDS = 60.0
_MOST_SKIPPED = 1_000_000

_MEMBERS = {
    "length": "length",
    "full_policy": "write.full_policy",
    "write_timeout": "write.timeout",
    "empty_policy": "read.empty_policy",
    "read_timeout": "read.timeout",
}
"""Members of a `buffer` option, and what OpenRTM calls them."""


@frozen
class BufferPolicy:
    """What one buffer does when it is full, and when it is empty.

    Attributes:
        length: messages that it holds.
        full: `overwrite` the oldest, `do_nothing` with the new one, or `block`.
        write_seconds: how long a writer waits with `block`.
        empty: `do_nothing`, `readback` of the last message once more, or `block`.
        read_seconds: how long a reader waits with `block`.
    """

    length: int = 8
    full: str = "overwrite"
    write_seconds: float = 1.0
    empty: str = "do_nothing"
    read_seconds: float = 1.0

    @property
    def longest_write(self) -> float:
        """Seconds that a writer may be made to wait."""
        return self.write_seconds if self.full == "block" else 0.0

    @property
    def longest_read(self) -> float:
        """Seconds that a reader may be made to wait."""
        return self.read_seconds if self.empty == "block" else 0.0


@frozen
class PushPolicy:
    """Which of the messages that wait an OutPort pushes.

    Attributes:
        which: the `new`est alone, one after the other (`fifo`), `all`, or `skip`.
        skipped: with `skip`, how many are left out before each that is pushed.
    """

    which: str = "new"
    skipped: int = 0


def policy_properties(options: Mapping[str, object]) -> dict[str, str]:
    """Return the connector properties that POLICY_OPTIONS ask for.

    Raises:
        ValueError: with the option or its member, what was expected and what came.
    """
    properties = {}
    for option, sides in (
        ("buffer", _SIDES),
        ("inport_buffer", _SIDES[:1]),
        ("outport_buffer", _SIDES[1:]),
    ):
        for name, text in _buffer_texts(option, options.get(option, {})).items():
            properties.update({f"dataport.{side}.buffer.{name}": text for side in sides})
    if "push_policy" in options:
        properties[_PUSH_POLICY] = _policy_word("push_policy", _policy_text(options["push_policy"]), _PUSH)
    if "skip_count" in options:
        if options.get("push_policy") != "skip":
            raise ValueError("skip_count means nothing without push_policy: skip")
        skipped = _policy_count("skip_count", _policy_text(options["skip_count"]), 0, _MOST_SKIPPED)
        properties[_SKIP_COUNT] = str(skipped)
    return properties


def buffer_policy(properties: Mapping[str, str], side: str) -> BufferPolicy:
    """Read the policy of the buffer at one side of a connector.

    What is said of the side comes before what is said of both (`dataport.buffer.`).

    Raises:
        ValueError: a property has a value that is unknown here.
    """
    said = {}
    for start in ("dataport.buffer.", f"dataport.{side}.buffer."):
        for name in _MEMBERS.values():
            text = properties.get(start + name, "").strip().lower()
            if text:
                said[name] = start + name, text
    return _policy(said)


def says_what_empty_means(properties: Mapping[str, str]) -> bool:
    """Whether properties say what an OutPort's buffer shall do while it is empty."""
    name = _MEMBERS["empty_policy"]
    return any(properties.get(f"dataport.{side}buffer.{name}") for side in ("", "outport."))


def push_policy(properties: Mapping[str, str]) -> PushPolicy:
    """Read which messages an OutPort is to push.

    Raises:
        ValueError: a property has a value that is unknown here.
    """
    which = properties.get(_PUSH_POLICY, "").strip().lower() or _PUSH[0]
    skipped = properties.get(_SKIP_COUNT, "").strip() or "0"
    return PushPolicy(
        _policy_word(_PUSH_POLICY, which, _PUSH), _policy_count(_SKIP_COUNT, skipped, 0, _MOST_SKIPPED)
    )


def _buffer_texts(option: str, table: object) -> dict[str, str]:
    """Return what the table of an option asks for, by OpenRTM's names below `buffer.`."""
    if not isinstance(table, Mapping):
        raise ValueError(f"{option} must be a table such as {{length: 4}}, got {table!r}")  # noqa: TRY004 - one kind
    unknown = sorted(set(table) - set(_MEMBERS), key=str)
    if unknown:
        text = f"{option} has no member {unknown[0]!r}; there are {', '.join(_MEMBERS)}"
        raise ValueError(text)
    for timeout, policy in (("write_timeout", "full_policy"), ("read_timeout", "empty_policy")):
        if timeout in table and table.get(policy) != "block":
            raise ValueError(f"{option}.{timeout} means nothing without {policy}: block")
    texts = {_MEMBERS[member]: _policy_text(value) for member, value in table.items()}
    _policy({_MEMBERS[item]: (f"{option}.{item}", texts[_MEMBERS[item]]) for item in table})
    return texts


def _policy(said: Mapping[str, tuple[str, str]]) -> BufferPolicy:
    """Read what is said, each with its place, and take what is usual for the rest."""
    usual = BufferPolicy()
    length, full, wait, empty, read = (said.get(name) for name in _MEMBERS.values())
    return BufferPolicy(
        _policy_count(*length, 1, _LONGEST) if length else usual.length,
        _policy_word(*full, _FULL) if full else usual.full,
        _policy_seconds(*wait) if wait else usual.write_seconds,
        _policy_word(*empty, _EMPTY) if empty else usual.empty,
        _policy_seconds(*read) if read else usual.read_seconds,
    )


def _policy_text(value: object) -> str:
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        return repr(value)
    return str(value)


def _policy_word(name: str, text: str, words: tuple[str, ...]) -> str:
    if text not in words:
        raise ValueError(f"{name} must be {' or '.join(words)}, got {text!r}")
    return text


def _policy_count(name: str, text: str, least: int, most: int) -> int:
    if not (text.isascii() and text.isdigit() and len(text) <= len(str(most))):
        number = -1
    else:
        number = int(text)
    if not least <= number <= most:
        raise ValueError(f"{name} must be a whole number from {least} to {most}, got {text!r}")
    return number


def _policy_seconds(name: str, text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not 0 <= seconds <= _MOST_SECONDS:
        raise ValueError(f"{name} must be seconds from 0 to {_MOST_SECONDS:g}, got {text!r}")
    return seconds
