"""What nodes say of a connection in its header, and what is wrong with what the other one said."""

from __future__ import annotations

from collections.abc import Mapping

__all__ = [
    "publisher_header",
    "publisher_problem",
    "service_header",
    "service_problem",
    "subscriber_header",
    "subscriber_problem",
]

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
