"""The IDL types that a bridge knows: ours and the configuration's, found by name."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable
from functools import cached_property
from typing import Any

from _uoarm_rtm_stubs import RTC, OpenRTM, SDOPackage

from uoarm.bridge import ServiceStructures
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import MessageStructure
from uoarm_rtm._codec import CdrCodec, codec_of
from uoarm_rtm._derived import derive, derive_interface
from uoarm_rtm._descriptor import descriptors, shape_of
from uoarm_rtm._operations import IdlInterface, interfaces
from uoarm_rtm._schema import structure_of
from uoarm_rtm._user_idl import load_idl

__all__ = ["Types", "plain_name"]

_ID = re.compile(r"(?:IDL:)?(?P<name>[^:]+?)(?::\d+\.\d+)?")


def plain_name(type_id: str) -> str:
    """Return `RTC/TimedLong` for any way of writing that type.

    Known are repository ids with and without a prefix, `RTC::TimedLong`, and bare names, which
    stay bare: `TimedLong` matches a type of that name in any module.
    """
    text = type_id.strip().replace("::", "/").strip("/")
    found = _ID.fullmatch(text)
    parts = (found["name"] if found else text).split("/")
    return "/".join(parts[1:] if len(parts) > 1 and "." in parts[0] else parts)


class Types:
    """The types of one bridge.

    Args:
        sources: IDL texts or files of the configuration; later ones win.
        encoding: of narrow strings.
        folder: where texts find what they include.

    Raises:
        BridgeError: a source cannot be compiled.
    """

    def __init__(
        self, sources: Iterable[str] = (), encoding: str = "utf-8", folder: str = "."
    ) -> None:
        self._encoding = encoding
        self._stubs = [load_idl(source, folder) for source in sources]
        self._codecs: dict[str, CdrCodec] = {}

    def codec(self, type_id: str) -> CdrCodec:
        """Return the codec of a type.

        Raises:
            BridgeError: UNSUPPORTED, when the type is unknown or holds what has no structure.
        """
        codec = self._codecs.get(type_id)
        if codec is None:
            codec = codec_of(shape_of(self.descriptor(type_id), type_id), self._encoding)
            self._codecs[type_id] = codec
        return codec

    def derive(self, port: str, structure: MessageStructure, *, is_read: bool) -> str:
        """Return the id of a type that carries a structure's messages; known from then on.

        Raises:
            BridgeError: as `_derived.derive`.
        """
        shape = derive(port, structure, is_read=is_read)
        self._codecs.setdefault(shape.name, codec_of(shape, self._encoding))
        return shape.name

    def derive_interface(
        self, port: str, structures: ServiceStructures
    ) -> tuple[IdlInterface, str]:
        """Return an interface for a service's messages, compiled, and its IDL.

        Raises:
            BridgeError: as `_derived.derive_interface`, or the compiler is not there.
        """
        idl, name = derive_interface(port, structures)
        return interfaces(load_idl(idl), self._encoding)[name], idl

    def structure(self, type_id: str) -> MessageStructure:
        """Return the message structure of a type; raises as `codec` does."""
        return structure_of(self.codec(type_id).shape, self._encoding)

    def descriptor(self, type_id: str) -> Any:
        """Return omniORB's descriptor of a type.

        Raises:
            BridgeError: UNSUPPORTED, when the type is unknown.
        """
        name = plain_name(type_id)
        if name in self._known:
            return self._known[name]
        if "/" not in name:
            ends = [known for known in self._known if known.endswith(f"/{name}")]
            if len(ends) == 1:
                return self._known[ends[0]]
        close = difflib.get_close_matches(name, self._known, n=1)
        hint = f"did you mean {close[0]!r}? Otherwise give" if close else "give"
        text = f"data type {type_id!r} is not known: {hint} its IDL in the bridge's option `idl`"
        raise BridgeError(text, FailureReason.UNSUPPORTED)

    def interface(self, name: str) -> tuple[IdlInterface, str]:
        """Return the interface that a text names, and the operation, empty for all of them.

        Args:
            name: `Module::Interface` or `Module::Interface::operation`, module optional.

        Raises:
            BridgeError: UNSUPPORTED, when no IDL of the configuration declares it.
        """
        plain = plain_name(name)
        known = self._interfaces
        for wanted, operation in ((plain, ""), tuple(plain.rpartition("/")[::2])):
            ends = [path for path in known if f"/{path}".endswith(f"/{wanted}")]
            if wanted and len(ends) == 1:
                return known[ends[0]], operation
        there = ", ".join(known) or "none"
        text = (
            f"interface {name!r} is not known (the option `idl` of the bridge declares {there}): "
            "give its IDL there"
        )
        raise BridgeError(text, FailureReason.UNSUPPORTED)

    def same(self, first: str, second: str) -> bool:
        """Whether two ways of writing a type name the same one."""
        first, second = plain_name(first), plain_name(second)
        return first == second or (
            ("/" in first) != ("/" in second) and first.split("/")[-1] == second.split("/")[-1]
        )

    @cached_property
    def _interfaces(self) -> dict[str, IdlInterface]:
        found: dict[str, IdlInterface] = {}
        for stubs in self._stubs:
            found.update(interfaces(stubs, self._encoding))
        return found

    @cached_property
    def _known(self) -> dict[str, Any]:
        known: dict[str, Any] = {}
        for module in (RTC, OpenRTM, SDOPackage):
            known.update((plain_name(name), found) for name, found in descriptors(module))
        for stubs in self._stubs:
            for scope in stubs.scopes:
                known.update((plain_name(name), found) for name, found in descriptors(scope))
        return known
