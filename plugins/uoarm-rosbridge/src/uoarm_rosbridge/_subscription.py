"""One client's subscription to one topic: its rate, its queue, its compression."""

from __future__ import annotations

import functools
import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from attrs import frozen

from uoarm import cdr
from uoarm.errors import ControlMessageError, MessageError
from uoarm.model import Message, MessageStructure
from uoarm.server.front_end import Client, MessageForm, Subscription, Throttle, write_binary
from uoarm_rosbridge._wire import (
    clock_now,
    fragment_size,
    split,
    write_publish,
    write_publish_cbor,
    write_publish_png,
)

__all__ = ["RawWriter", "RosbridgeSubscription", "SubscribeOptions", "read_options"]

_head = struct.Struct(">BI").pack
_BYTE_STRING = 0x5A  # of CBOR, behind which its length stands in four octets


class RawWriter:
    """Writes a topic's messages for those who read the serialised form themselves.

    Args:
        topic: as the client named it.
        structure: says what the messages are like now; a takeover may change it.
    """

    def __init__(self, topic: str, structure: Callable[[], MessageStructure]) -> None:
        self._topic = topic
        self._structure = structure
        self._known: MessageStructure | None = None
        self._serialise: Callable[[Message], Sequence[cdr.Part]] | None = None

    def __call__(self, number: int, message: Message) -> bytes:
        """Return a publish message.

        Raises:
            MessageError: the message does not fit, or its structure has no fixed layout.
        """
        del number
        seconds, nanoseconds = clock_now()
        parts = self.prepare()(message)
        raw = {"secs": seconds, "nsecs": nanoseconds, "bytes": b""}
        before = write_binary({"op": "publish", "topic": self._topic, "msg": raw})
        length = sum(memoryview(part).nbytes for part in parts)
        return b"".join((before[:-1], _head(_BYTE_STRING, length), *parts))

    def prepare(self) -> Callable[[Message], Sequence[cdr.Part]]:
        """Read the structure, unless it is known, and return what serialises its messages.

        Raises:
            MessageError: the structure has no fixed layout.
        """
        structure = self._structure()
        if self._serialise is None or structure is not self._known:
            try:
                self._serialise = cdr.Codec(structure).encode_parts
            except MessageError as error:
                raise MessageError(f"{error}; ask for cbor instead of cbor-raw") from None
            self._known = structure
        return self._serialise


_RAW = "cbor-raw"
_TEXTS = {"none": write_publish, "png": write_publish_png}
_COMPRESSIONS = (*_TEXTS, "cbor", _RAW)
_MOST = 100_000


@frozen
class SubscribeOptions:
    """What one subscribe message asks for.

    Attributes:
        every: least seconds between two messages.
        length: messages kept while the client must not have them yet; 0: only the newest goes.
        fragment: longest text of one frame in characters; 0: any.
        compression: `none`, `png`, `cbor` or `cbor-raw`.
    """

    every: float = 0.0
    length: int = 0
    fragment: int = 0
    compression: str = "none"


def read_options(fields: Mapping[str, Any]) -> SubscribeOptions:
    """Return what a subscribe message asks for.

    Raises:
        ControlMessageError: it asks for a compression that is not served.
    """
    compression = fields.get("compression") or "none"
    if compression not in _COMPRESSIONS:
        raise ControlMessageError(
            f"subscribe: compression {compression!r:.60} is not served; "
            f"use {', '.join(_COMPRESSIONS[:-1])} or {_RAW}"
        )
    return SubscribeOptions(
        every=float(fields.get("throttle_rate") or 0) / 1000,
        length=min(int(fields.get("queue_length") or 0), _MOST),
        fragment=fragment_size(fields),
        compression=compression,
    )


class RosbridgeSubscription(Subscription):
    """The subscription of one client to one topic, as its subscribe messages together ask.

    The highest rate and the longest queue hold; the compression is that of the first.

    Args:
        topic: as the client named it.
        options: of the first subscribe message.
        client: who listens.
        structure: says what the messages are like, for `cbor-raw`.
        on_refused: called once with each reason for which a message could not be written.
        on_end: called with why no more will come.
    """

    def __init__(
        self,
        topic: str,
        options: SubscribeOptions,
        client: Client,
        *,
        structure: Callable[[], MessageStructure],
        on_refused: Callable[[MessageError], None],
        on_end: Callable[[str, str], None],
    ) -> None:
        self.asked: dict[str, SubscribeOptions] = {}
        self._raw = RawWriter(topic, structure) if options.compression == _RAW else None
        write = _TEXTS.get(options.compression, write_publish_cbor)
        text = options.compression in _TEXTS
        pieces = functools.partial(_pieces, topic, options.fragment)
        form = MessageForm(
            f"ros-{options.compression}:{topic}",
            self._raw or functools.partial(write, topic),
            text,
            frames=pieces if text and options.fragment else None,
        )
        throttle = Throttle(options.every, is_even=False)
        super().__init__(client, form, throttle=throttle, on_refused=on_refused, on_end=on_end)

    def check_form(self) -> None:
        """Make ready for messages, whose structure is known now.

        Raises:
            MessageError: they have no form in the compression that was asked for.
        """
        if self._raw is not None:
            self._raw.prepare()

    def set_options(self, identity: str, options: SubscribeOptions) -> None:
        """Add or replace a wish."""
        self.asked[identity] = options
        self._settle()

    def drop(self, identity: str | None) -> bool:
        """Take a wish back, or all; True when none is left."""
        if identity is None:
            self.asked.clear()
        else:
            self.asked.pop(identity, None)
        self._settle()
        return not self.asked

    def _settle(self) -> None:
        asked = self.asked.values()
        every = min((options.every for options in asked), default=0.0)
        self.set_rate(every, max((options.length for options in asked), default=0))


def _pieces(topic: str, size: int, frame: bytes, number: int) -> list[bytes]:
    return split(frame, size, f"uoarm:{topic}:{number}")
