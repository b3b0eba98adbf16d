"""Messages with their header: written, read, and held against a structure."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from datetime import datetime, timezone
from typing import Any

from attrs import field, frozen
from jsonschema import Draft202012Validator
from uoarm_mqtt.connection import PayloadCodec

from uoarm.errors import MessageError
from uoarm.model import Message, MessageStructure, Schema
from uoarm_vda5050._releases import Release
from uoarm_vda5050._structures import HEADER

__all__ = ["HEADER_IDS", "HEADER_OCTETS", "Check", "Headers", "VdaCodec", "check_of"]

HEADER_OCTETS = 320
"""About how many a header has at most, with names of the usual length."""
HEADER_IDS = 2**32
"""How many there are: the counter of a header is one of 32 bits."""

Check = Callable[[object], str]
"""Says what is wrong with a message, "" where nothing is."""


class Headers:
    """The headers of what is sent to, or by, one vehicle. Thread safe."""

    def __init__(self, release: Release, manufacturer: str, serial_number: str) -> None:
        self._fixed = {
            "version": release.version,
            "manufacturer": manufacturer,
            "serialNumber": serial_number,
        }
        self._counts: dict[str, itertools.count[int]] = {}
        self._lock = threading.Lock()

    def next(self, topic: str) -> dict[str, Any]:
        """Return the header of the next message on a topic."""
        with self._lock:
            count = next(self._counts.setdefault(topic, itertools.count()))
        return {"headerId": count % HEADER_IDS, "timestamp": _timestamp(), **self._fixed}


def _timestamp() -> str:
    """Return the time as the standard writes it: ISO 8601, UTC, with fractions of a second."""
    return datetime.now(timezone.utc).isoformat(timespec="milliseconds").replace("+00:00", "Z")


@frozen
class VdaCodec(PayloadCodec):
    """JSON with a header, which is no part of the message unless it is asked for.

    Attributes:
        release: that is spoken.
        topic: last level of the topic.
        headers: of what is written; None where nothing is.
        check: of whole messages.
        is_header_kept: whether what is read keeps its header.
    """

    release: Release = field(kw_only=True)
    topic: str = field(kw_only=True)
    headers: Headers | None = field(default=None, kw_only=True)
    check: Check = field(default=lambda _: "", kw_only=True)
    is_header_kept: bool = field(default=False, kw_only=True)

    @classmethod
    def reading(cls, structure: MessageStructure, plain: PayloadCodec, **more: Any) -> VdaCodec:
        """Return a codec for a structure, with the budget of another one."""
        made = PayloadCodec.of("json", structure, plain.budget)
        return cls("json", plain.budget, made.convert, **more)

    def encode(self, message: Message) -> bytes:
        """Return the payload of a message, with the next header.

        Raises:
            MessageError: it is none of this topic, or too large.
        """
        if not isinstance(message, dict):
            text = f"{self.topic}: expected an object, got {type(message).__name__}"
            raise MessageError(text)
        assert self.headers is not None, "what writes has headers"
        whole = {
            **self.headers.next(self.topic),
            **{k: v for k, v in message.items() if k not in HEADER},
        }
        payload = super().encode(whole)
        if wrong := self.check(whole):
            raise MessageError(f"{self.topic}: {wrong}")
        return payload

    def decode(self, payload: bytes, content_type: str = "") -> Message:
        """Return the message of a payload.

        Raises:
            MessageError: it cannot be read, is of another major version, or has another structure.
        """
        return self.split(payload, content_type)[1]

    def split(self, payload: bytes, content_type: str = "") -> tuple[dict[str, Any], Message]:
        """Return header and message of a payload.

        Raises:
            MessageError: as `decode`.
        """
        whole = super().decode(payload, content_type)
        if not isinstance(whole, dict):
            raise MessageError(f"{self.topic}: expected an object, got {type(whole).__name__}")
        if wrong := self.wrong_version(whole.get("version")) or self.check(whole):
            raise MessageError(f"{self.topic}: {wrong}")
        header = {key: whole[key] for key in HEADER if key in whole}
        if self.is_header_kept:
            return header, whole
        return header, {key: value for key, value in whole.items() if key not in HEADER}

    def wrong_version(self, version: object) -> str:
        """Say what is wrong with the version in a header, "" where nothing is."""
        if version is None or str(version).partition(".")[0] == self.release.major:
            return ""
        return f"version {str(version)[:20]!r}, while the bridge's `release` is {self.release.name}"


def check_of(schema: Schema) -> Check:
    """Return what holds messages against a schema."""
    validator = Draft202012Validator(schema)

    def check(message: object) -> str:
        try:
            for error in validator.iter_errors(message):
                where = "/".join(map(str, error.absolute_path)) or "the message"
                return f"{where}: {error.message[:300]}"
        except Exception as error:  # noqa: BLE001 - of a user's schema: references, numbers, depth
            text = f"{type(error).__name__}: {error}"[:300]
            return f"it cannot be held against the schema: {text}"
        return ""

    return check
