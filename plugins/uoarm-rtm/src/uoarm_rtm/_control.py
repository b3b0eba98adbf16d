"""The lifecycle of components as a call; and the structures of it and of `_configuration`."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

from _uoarm_rtm_stubs import RTC

from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Message, MessageStructure
from uoarm_rtm._faults import corba_errors
from uoarm_rtm._peer import PeerComponent, contexts_of, state_of

__all__ = [
    "CONFIGURATION_REPLY",
    "CONFIGURATION_REQUEST",
    "LIFECYCLE_REPLY",
    "LIFECYCLE_REQUEST",
    "change",
    "drive",
]

_GLANCE_SECONDS = 0.02
_GOALS = {"activate": "active", "deactivate": "inactive", "reset": "inactive"}
_STATES = ["created", "inactive", "active", "error", "none"]
_TEXTS: dict[str, Any] = {"type": "object", "additionalProperties": {"type": "string"}}


def _closed(properties: dict[str, Any], *required: str) -> MessageStructure:
    return MessageStructure(
        {
            "type": "object",
            "properties": properties,
            "required": list(required),
            "additionalProperties": False,
        }
    )


LIFECYCLE_REQUEST = _closed({"action": {"enum": [*_GOALS, "state"]}}, "action")
LIFECYCLE_REPLY = _closed({"state": {"enum": _STATES}}, "state")
CONFIGURATION_REQUEST = _closed(
    {
        "set": {"type": "string"},
        "values": _TEXTS,
        "activate": {"type": "boolean"},
        "create": {"type": "boolean"},
    }
)
CONFIGURATION_REPLY = _closed(
    {
        "active": {"type": "string"},
        "sets": {"type": "object", "additionalProperties": _TEXTS},
        "constraints": _TEXTS,
        "widgets": _TEXTS,
        "types": _TEXTS,
        "warnings": {"type": "array", "items": {"type": "string"}},
    },
    *("active", "sets"),
)


def drive(peer: PeerComponent, message: Message, seconds: float) -> Message:
    """Answer a request to a component's lifecycle.

    Raises:
        MessageError: there is no such action.
        BridgeError: as `change` does.
    """
    action = message.get("action") if isinstance(message, Mapping) else None
    if action == "state":
        return {"state": state_of(peer, seconds)}
    if action not in _GOALS:
        raise MessageError(f"$.action: expected one of {', '.join(_GOALS)}, state; got {action!r}")
    return {"state": change(peer, action, seconds)}


def change(peer: PeerComponent, action: str, seconds: float, *, there_is_fine: bool = False) -> str:
    """Change a component's state in its first context and wait until it has changed.

    Components answer RTC_ERROR to a change that takes more than half a second and make it all
    the same (observed), so it is the state that counts.

    Args:
        peer: the component.
        action: `activate`, `deactivate` or `reset`.
        seconds: limit of each call, and of the wait.
        there_is_fine: whether to leave a component alone that is in the wanted state.

    Returns:
        the state, which is the wanted one.

    Raises:
        BridgeError: REFUSED, with the answer and the state it is in.
        BridgeTimeoutError: the component hangs, or stays in its state.
    """
    goal = _GOALS[action]
    what = f"component {peer.path!r}: {action}"
    contexts = contexts_of(peer, seconds)
    if not contexts:
        raise BridgeError(f"{what}: it has no execution context", FailureReason.UNSUPPORTED)
    if there_is_fine and state_of(peer, seconds) == goal:
        return goal
    with corba_errors(what):
        code = getattr(contexts[0], f"{action}_component")(peer.reference)
    if code not in {RTC.RTC_OK, RTC.RTC_ERROR}:
        text = f"{what}: it answers {code}, being {state_of(peer, seconds)}"
        raise BridgeError(text, FailureReason.REFUSED)
    deadline = time.monotonic() + seconds
    while True:
        state = state_of(peer, seconds)
        if state == goal:
            return state
        if state == "error" and action != "reset":
            raise BridgeError(f"{what}: it failed and is in error now", FailureReason.REFUSED)
        if time.monotonic() > deadline:
            if code == RTC.RTC_ERROR:
                text = f"{what}: it answers RTC_ERROR and is still {state}"
                raise BridgeError(text, FailureReason.REFUSED)
            raise BridgeTimeoutError(f"{what}: it is still {state} after {seconds:g} s")
        time.sleep(_GLANCE_SECONDS)
