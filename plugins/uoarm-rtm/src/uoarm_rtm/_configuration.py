"""The configuration sets of a component: what is written is checked before, and read back after.

OpenRTM takes any name and any value for any parameter, has no active set after a write until one is
activated, and forgets sets that it does not know without an error (observed).
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any

from _uoarm_rtm_stubs import SDOPackage
from attrs import frozen

from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Message
from uoarm_rtm._constraints import CONSTRAINTS, TYPES, WIDGETS, doubt, problem
from uoarm_rtm._faults import corba_errors
from uoarm_rtm._orb import narrowed
from uoarm_rtm._peer import PeerComponent, pairs, properties_of

__all__ = ["configure", "limits"]

_log = logging.getLogger("uoarm.rtm")


def configure(peer: PeerComponent, message: Message, seconds: float) -> Message:
    """Answer a request to a component's configuration: write what it holds, then read all.

    Raises:
        MessageError: the request is something else, or holds a set, a name or a value that the
            component does not have or allow; nothing has been written.
        BridgeError: REFUSED with the component's words, or where it does not keep what was written.
    """
    if not isinstance(message, Mapping):
        raise MessageError("$: expected an object with set, values, activate, or an empty one")
    what, target = _target(peer, seconds)
    with corba_errors(what):
        try:
            before = _read(target)
            written = _checked(before, message)
            if written or message.get("activate"):
                _write(target, before, message, written)
            now = _read(target)
        except (SDOPackage.InvalidParameter, SDOPackage.NotAvailable) as error:
            text = f"{what}: {type(error).__name__}: {error.description}"
            raise BridgeError(text, FailureReason.REFUSED) from error
        except SDOPackage.InternalError as error:
            text = f"{what}: {error.description}"
            raise BridgeError(text, FailureReason.REFUSED) from error
    _kept(what, _name(before, message), written, now)
    doubts = _doubts(before, written)
    for name in doubts:
        _log.warning("%s: %s", what, name)
    return {**now.reply(), **({"warnings": doubts} if doubts else {})}


def limits(peer: PeerComponent, seconds: float) -> str:
    """Return the parameters with what the component says that they may be, in one line.

    Raises:
        BridgeError: it is gone, hangs, or has no configuration.
    """
    what, target = _target(peer, seconds)
    with corba_errors(what):
        sets = _read(target)
    names = dict.fromkeys(name for mapping in sets.usual.values() for name in mapping)
    return ", ".join(f"{name} {sets.annotation(CONSTRAINTS, name)}".strip() for name in names)


def _target(peer: PeerComponent, seconds: float) -> tuple[str, Any]:
    """Return a component's configuration, after what to call it in errors."""
    what = f"component {peer.path!r}: configuration"
    with corba_errors(what):
        reference = peer.reference.get_configuration()
    return what, narrowed(reference, SDOPackage.Configuration, seconds, what)


@frozen
class _ConfigurationSets:
    """All configuration sets, and the name of the active one, empty for none."""

    active: str
    every: Mapping[str, Mapping[str, str]]

    @property
    def usual(self) -> dict[str, Mapping[str, str]]:
        """Without those that only say something of parameters."""
        return {name: value for name, value in self.every.items() if not name.startswith("__")}

    def annotation(self, about: str, name: str) -> str:
        """Return what one of those, such as `CONSTRAINTS`, says of a parameter."""
        return self.every.get(about, {}).get(name, "")

    def reply(self) -> dict[str, Any]:
        """Return what the service answers."""
        about = {"constraints": CONSTRAINTS, "widgets": WIDGETS, "types": TYPES}
        reports = {
            word: dict(self.every[value]) for word, value in about.items() if value in self.every
        }
        sets = {name: dict(value) for name, value in self.usual.items()}
        return {"active": self.active, "sets": sets, **reports}


def _read(target: Any) -> _ConfigurationSets:
    listing = target.get_configuration_sets()
    sets = {str(item.id): properties_of(item.configuration_data) for item in listing}
    try:
        active = str(target.get_active_configuration_set().id)
    except SDOPackage.NotAvailable:
        active = ""
    return _ConfigurationSets(active, sets)


def _name(sets: _ConfigurationSets, message: Mapping[str, Any]) -> str:
    return str(message.get("set") or sets.active or "default")


def _checked(sets: _ConfigurationSets, message: Mapping[str, Any]) -> dict[str, str]:
    """Return what a request writes, every value as text."""
    values, name = message.get("values") or {}, _name(sets, message)
    if not isinstance(values, Mapping):
        raise MessageError(f"$.values: expected a table of strings, got {values!r}")
    is_new = name not in sets.usual
    if (message.get("set") or values) and is_new and not message.get("create"):
        there = ", ".join(sets.usual) or "none"
        text = f"$.set: there is no configuration set {name!r}; there are {there}"
        raise MessageError(f"{text}. `create: true` makes it")
    known = {word for mapping in sets.usual.values() for word in mapping}
    written = {}
    for parameter, value in values.items():
        if parameter not in known:
            names = ", ".join(sorted(known)) or "none"
            raise MessageError(f"$.values: there is no parameter {parameter!r}; there are {names}")
        written[parameter] = text = str(value)
        wrong = problem(
            text, *(sets.annotation(about, parameter) for about in (CONSTRAINTS, TYPES, WIDGETS))
        )
        if wrong:
            raise MessageError(f"$.values.{parameter}: {wrong}")
    return written


def _doubts(before: _ConfigurationSets, written: Mapping[str, str]) -> list[str]:
    """Return what is odd about the values of parameters that the component does not describe."""
    doubts = []
    for parameter, value in written.items():
        if not any(before.annotation(about, parameter) for about in (CONSTRAINTS, TYPES)):
            held = [mapping[parameter] for mapping in before.usual.values() if parameter in mapping]
            doubts.append((parameter, doubt(value, held)))
    return [f"values.{parameter}: {text}" for parameter, text in doubts if text]


def _write(
    target: Any, before: _ConfigurationSets, message: Mapping[str, Any], written: Mapping[str, str]
) -> None:
    """Write values, and leave that set in force which was, unless another is asked for."""
    name = _name(before, message)
    listing = SDOPackage.ConfigurationSet(name, "", pairs(written))
    if name not in before.usual:
        target.add_configuration_set(listing)
    elif written:
        target.set_configuration_set_values(listing)
    active = name if message.get("activate") else before.active
    if active:
        target.activate_configuration_set(active)


def _kept(what: str, name: str, written: Mapping[str, str], now: _ConfigurationSets) -> None:
    """Compare what the component has with what was written.

    Raises:
        BridgeError: REFUSED, with the first difference.
    """
    if not written:
        return
    there = now.usual.get(name)
    if there is None:
        text = f"{what}: it took the set {name!r} without an error, and does not have it"
        raise BridgeError(text, FailureReason.REFUSED)
    for parameter, value in written.items():
        if there.get(parameter) != value:
            text = f"{what}: {name}.{parameter} is {there.get(parameter)!r}, not {value!r}"
            raise BridgeError(f"{text}: the component does not keep it", FailureReason.REFUSED)
