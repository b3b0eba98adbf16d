"""Message structures: what a port carries, as JSON Schema with annotations."""

from __future__ import annotations

import hashlib
import json
from functools import cached_property

from attrs import field, frozen

from uoarm.model._values import Schema

__all__ = ["MessageStructure"]


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
        text = json.dumps([self.schema, self.native_type], sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MessageStructure):
            return NotImplemented
        return self is other or self.fingerprint == other.fingerprint

    def __hash__(self) -> int:
        return hash(self.fingerprint)
