"""Control messages: what applications and the manager say to each other."""

from __future__ import annotations

from enum import Enum

from attrs import field, frozen

from uoarm.model._values import Message, Options

__all__ = ["ControlMessage", "Op"]


class Op(Enum):
    """The operation of a control message, spelt as on the wire."""

    REQUEST = "Request"
    KILL = "Kill"
    DATA = "Data"
    CALL = "Call"
    REPLY = "Reply"
    STATUS = "Status"
    ERROR = "Error"
    LIST = "List"
    RESOLVE = "Resolve"
    RESUME = "Resume"
    CONFIGURE = "Configure"
    STOP = "Stop"
    DISCOVER = "Discover"


@frozen
class ControlMessage:
    """One control message `{op, type, jsonMessage, id}`.

    Attributes:
        op: the operation.
        type: the function (client to manager), or the strings that a bridge needs to reach a
            component (manager to bridge).
        jsonMessage: the data, to or from the component.
        id: chosen by whoever asks; the answer carries the same one.
        extensions: fields whose names begin with `x-`; kept, never interpreted.
    """

    op: Op
    type: str | tuple[str, ...] = ""
    jsonMessage: Message = field(default=None, hash=False)  # noqa: N815 - the wire's spelling
    id: str | None = None
    extensions: Options = field(factory=dict, hash=False)
