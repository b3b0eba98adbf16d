"""TCPROS without I/O: headers of connections, what is wrong with one, and the messages after it.

Everything that a peer may send has a bound before it is read: a hostile node or master costs no
more than its budget.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping

_ANY = "*"
Header = Mapping[str, str]


def subscriber_header(caller: str, topic: str, *, nodelay: bool = True) -> dict[str, str]:
    """Return what a subscriber says first: any type will do, it looks at the answer itself."""
    header = {"callerid": caller, "md5sum": _ANY, "topic": topic, "type": _ANY}
    return {**header, "tcp_nodelay": "1"} if nodelay else header


def publisher_header(
    caller: str, topic: str, kind: str, md5: str, definition: str, *, latching: bool
) -> dict[str, str]:
    """Return what a publisher answers."""
    return {
        "callerid": caller,
        "latching": "1" if latching else "0",
        "md5sum": md5,
        "message_definition": definition,
        "topic": topic,
        "type": kind,
    }


def service_header(
    caller: str, service: str, md5: str = _ANY, *, probe: bool = False, persistent: bool = False
) -> dict[str, str]:
    """Return what a client of a service says first; a probe asks for the type alone."""
    header = {"callerid": caller, "md5sum": md5, "service": service}
    return {
        **header,
        **({"probe": "1"} if probe else {}),
        **({"persistent": "1"} if persistent else {}),
    }


def subscriber_problem(header: Header, topic: str, kind: str, md5: str) -> str:
    """Return why a subscriber cannot have a topic that we publish, nothing where it can."""
    if missing := [name for name in ("callerid", "md5sum", "topic", "type") if name not in header]:
        return f"the header of the connection has no field {missing[0]}"
    caller = header["callerid"]
    if header["md5sum"] not in {_ANY, md5} or header["type"] not in {_ANY, kind}:
        return (
            f"{caller} wants topic {topic} as {header['type']} (md5sum {header['md5sum']}), "
            f"and here it is {kind} (md5sum {md5}): build both of one definition"
        )
    return ""


def publisher_problem(header: Header, topic: str, kind: str, md5: str) -> str:
    """Return what is wrong with what a publisher answered, nothing where it will do.

    Args:
        header: of the publisher.
        topic: that was asked for.
        kind: of messages that are expected; empty: any.
        md5: of the expected type; empty: any.
    """
    if "error" in header:
        return f"the publisher refuses: {header['error'][:500]}"
    if missing := [name for name in ("md5sum", "type") if not header.get(name)]:
        return f"the publisher's header has no field {missing[0]}"
    if (kind and header["type"] != kind) or (md5 and header["md5sum"] != md5):
        caller = header.get("callerid", "the publisher")
        wanted = f"{kind or 'its type'}{f' (md5sum {md5})' if md5 else ''}"
        return (
            f"{caller} publishes {topic} as {header['type']} (md5sum {header['md5sum']}), "
            f"and {wanted} is expected"
        )
    return ""


def service_problem(header: Header, service: str, kind: str, md5: str) -> str:
    """Return why a service that we serve cannot be called so, nothing where it can."""
    if missing := [name for name in ("callerid", "md5sum", "service") if name not in header]:
        return f"the header of the connection has no field {missing[0]}"
    if header["md5sum"] not in {_ANY, md5}:
        return (
            f"{header['callerid']} calls {service} with md5sum {header['md5sum']}, and here it is "
            f"{kind} (md5sum {md5}): build both of one definition"
        )
    return ""


MAX_HEADER_OCTETS = 1 << 20  # the definition of a type stands in it
_MAX_FIELDS = 100
_LENGTH = struct.Struct("<I")
_STAGE_OCTETS = 1 << 16


class ProtocolError(Exception):
    """A peer does not keep to the protocol, or to its budget; the text says in what."""


def encode_header(fields: Mapping[str, str]) -> bytes:
    """Return a header with its length in front."""
    parts = []
    for name, value in fields.items():
        entry = f"{name}={value}".encode("utf-8", "replace")
        parts += [_LENGTH.pack(len(entry)), entry]
    octets = b"".join(parts)
    return _LENGTH.pack(len(octets)) + octets


def decode_header(octets: bytes | bytearray) -> dict[str, str]:
    """Return the fields of a header, without the length that stood in front.

    Raises:
        ProtocolError: it is cut short, too long, or a field has no name.
    """
    if len(octets) > MAX_HEADER_OCTETS:
        raise ProtocolError(
            f"a header of {len(octets):,} octets; {MAX_HEADER_OCTETS:,} are allowed"
        )
    fields: dict[str, str] = {}
    at = 0
    while at < len(octets):
        if at + _LENGTH.size > len(octets):
            raise ProtocolError("a header that ends within the length of a field")
        (length,) = _LENGTH.unpack_from(octets, at)
        at += _LENGTH.size
        if at + length > len(octets):
            raise ProtocolError(f"a header with a field of {length:,} octets, more than it has")
        name, separator, value = octets[at : at + length].decode("utf-8", "replace").partition("=")
        if not separator or not name:
            raise ProtocolError(f"a header with a field without a name: {name[:80]!r}")
        fields[name] = value
        if len(fields) > _MAX_FIELDS:
            raise ProtocolError(f"a header with more than {_MAX_FIELDS} fields")
        at += length
    return fields


def frames_of(run: memoryview) -> Iterator[memoryview]:
    """Return the frames of a run, each with its length in front."""
    at = 0
    while at < len(run):
        end = at + _LENGTH.size + _LENGTH.unpack_from(run, at)[0]
        yield run[at:end]
        at = end


class TcprosReader:
    """Takes a stream apart into frames, each of which stands behind its length in four octets.

    Octets are received into `buffer`; small frames are copied out of it, large ones are received
    where they stay. A frame is the reader's no more once it was returned.

    Args:
        most: octets that a frame may have.

    Attributes:
        in_runs: whether frames that came together are returned as one run, each with its length
            in front, to be sent on.
        ready: frames that came together with one that was asked for.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self.in_runs = False
        self.ready: list[bytes | bytearray] = []
        self._stage = memoryview(bytearray(_STAGE_OCTETS))
        self._filled = 0
        self._large: bytearray | None = None
        self._large_filled = 0

    @property
    def held(self) -> int:
        """How many octets wait here for the rest of their frame."""
        return self._filled if self._large is None else len(self._large)

    @property
    def is_between_frames(self) -> bool:
        """Whether nothing of a frame that is not whole has come."""
        return self._large is None and not self._filled

    def buffer(self) -> memoryview:
        """Return where the next octets go; never empty."""
        if self._large is not None:
            return memoryview(self._large)[self._large_filled :]
        return self._stage[self._filled :] if self._filled else self._stage

    def received(self, count: int) -> list[bytes | bytearray]:
        """Take note of so many octets in the buffer; returns what is whole by them.

        Raises:
            ProtocolError: a frame is longer than is allowed.
        """
        if self._large is not None:
            self._large_filled += count
            if self._large_filled < len(self._large):
                return []
            frame, self._large = self._large, None
            return [frame]
        self._filled += count
        frames: list[bytes | bytearray] = []
        stage, at, left = self._stage, 0, 0  # whole up to `at`, kept from `left` on
        while self._filled - at >= _LENGTH.size:
            (length,) = _LENGTH.unpack_from(stage, at)
            if length > self.most:
                allowed = f"{self.most:,} are allowed (max_octets)"
                raise ProtocolError(f"a message of {length:,} octets; {allowed}")
            start = at + _LENGTH.size
            end = start + length
            if end > self._filled:
                if end - at > _STAGE_OCTETS:
                    first = at if self.in_runs else start
                    self._large = bytearray(end - first)
                    self._large_filled = self._filled - first
                    self._large[: self._large_filled] = stage[first : self._filled]
                    left = self._filled
                break
            if not self.in_runs:
                frames.append(bytes(stage[start:end]))
            at = left = end
        if self.in_runs and at:
            frames.append(bytes(stage[:at]))
        at = left
        self._filled -= at
        if at and self._filled:
            stage[: self._filled] = bytes(stage[at : at + self._filled])
        return frames


class ReplyReader:
    """Takes replies of a service apart: an octet that says whether it succeeded, then a frame."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._octets = bytearray()

    def received(self, octets: bytes) -> tuple[bool, bytes] | None:
        """Take octets; returns whether the call succeeded, and its reply, once that is whole.

        Raises:
            ProtocolError: the reply is longer than is allowed, or more came than one reply.
        """
        self._octets += octets
        head = 1 + _LENGTH.size
        if len(self._octets) < head:
            return None
        (length,) = _LENGTH.unpack_from(self._octets, 1)
        if length > self._most:
            allowed = f"{self._most:,} are allowed (max_octets)"
            raise ProtocolError(f"a reply of {length:,} octets; {allowed}")
        if len(self._octets) < head + length:
            return None
        if len(self._octets) > head + length:
            raise ProtocolError("a second reply to one request")
        reply = bool(self._octets[0]), bytes(self._octets[head:])
        self._octets = bytearray()
        return reply
