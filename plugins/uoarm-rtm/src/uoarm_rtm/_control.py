"""Lifecycle and configuration of components, as calls of `@lifecycle` and `@configuration`.

A configuration is checked before it is written, and read back after: OpenRTM takes any name and
any value for any parameter, has no active set after a write until one is activated, and forgets
sets that it does not know without an error (observed). What a parameter may be stands in
configuration sets of their own, `__constraints__`, `__widget__` and `__type__`, by the parameter's
name. OpenRTM's tools keep to them; the components themselves do not.
"""

from __future__ import annotations

import operator
import re
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from _uoarm_rtm_stubs import RTC, SDOPackage
from attrs import define, field, frozen

from uoarm.bridge import Channel, Description, Log
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.model import Message, MessageStructure, closed_object
from uoarm_rtm._options import CONFIGURATION, LIFECYCLE, RtmEndpointOptions
from uoarm_rtm._orb import corba_errors, narrowed
from uoarm_rtm._peer import PeerComponent, contexts_of, pairs, properties_of, state_of
from uoarm_rtm._watch import Check

_GLANCE_SECONDS = 0.02
_GOALS = {"activate": "active", "deactivate": "inactive", "reset": "inactive"}
_STATES = ["created", "inactive", "active", "error", "none"]
_TEXTS: dict[str, Any] = {"type": "object", "additionalProperties": {"type": "string"}}


def _closed(properties: dict[str, Any], *required: str) -> MessageStructure:
    return MessageStructure(closed_object(properties, required))


_LIFECYCLE_REQUEST = _closed({"action": {"enum": [*_GOALS, "state"]}}, "action")
_LIFECYCLE_REPLY = _closed({"state": {"enum": _STATES}}, "state")
_CONFIGURATION_REQUEST = _closed(
    {
        "set": {"type": "string"},
        "values": _TEXTS,
        "activate": {"type": "boolean"},
        "create": {"type": "boolean"},
    }
)
_CONFIGURATION_REPLY = _closed(
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
DESCRIPTIONS = {
    LIFECYCLE: Description(request=_LIFECYCLE_REQUEST, reply=_LIFECYCLE_REPLY),
    CONFIGURATION: Description(request=_CONFIGURATION_REQUEST, reply=_CONFIGURATION_REPLY),
}
"""Of the services that each component has, by the port name in an endpoint's address."""


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


CONSTRAINTS, WIDGETS, TYPES = "__constraints__", "__widget__", "__type__"

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_ONE_SIDE = re.compile(rf"x\s*(<=|>=|<|>|==)\s*({_NUMBER})|({_NUMBER})\s*(<=|>=|<|>)\s*x")
_BOTH_SIDES = re.compile(rf"({_NUMBER})\s*(<=|<|>=|>)\s*x\s*(<=|<|>=|>)\s*({_NUMBER})")
_COMPARE: Mapping[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
}
_WHOLE = re.compile(r"[-+]?\d+")
_WHOLES = {"short", "int", "long", "unsigned short", "unsigned int", "unsigned long"}
_NUMBERS = {"float", "double"}


def problem(value: str, constraint: str, kind: str, widget: str) -> str:
    """Return what is wrong with a parameter's value, or "".

    A constraint or type that is written as nothing we know says nothing. Of a list, separated by
    commas, each element must fit.

    Args:
        value: as it is to be written.
        constraint: such as `0<=x<=150` or `(a,b)`; empty for none.
        kind: type, such as `int` or `vector<double>`; empty where it is not declared.
        widget: such as `slider.10`, which only numbers have, or `text`.
    """
    vector = re.fullmatch(r"(?:std::)?vector<(.*)>", kind.strip().lower())
    kind = vector.group(1).strip() if vector else kind.strip().lower()
    constraint = constraint.strip()
    if constraint.startswith("(") and constraint.endswith(")"):
        words = [word.strip() for word in constraint[1:-1].split(",")]
        given = [word.strip() for word in value.split(",")] if widget == "checkbox" else [value]
        return "" if all(name in words for name in given) else f"expected one of {constraint}"
    tests = [_test(word.strip()) for word in constraint.split(",")] if constraint else []
    numeric = (
        any(tests) or widget.split(".", maxsplit=1)[0] in {"slider", "spin"} or kind in _NUMBERS
    )
    for index, element in enumerate(word.strip() for word in value.split(",")):
        if kind in _WHOLES and not _WHOLE.fullmatch(element):
            return f"expected {kind}, got {element!r}"
        if not numeric:
            continue
        if not re.fullmatch(_NUMBER, element):
            return f"expected a number, got {element!r}"
        test = tests[min(index, len(tests) - 1)] if tests else None
        if test is not None and not test(float(element)):
            return f"expected {constraint}, got {element}"
    return ""


def doubt(value: str, before: Iterable[str]) -> str:
    """Return what is odd about a value where the component declares no type and no constraint.

    One that has a number where the text is none takes its default, without an error (observed);
    but a number and a text that happens to look like one are the same here, so it is no problem.

    Args:
        value: as it was written.
        before: the parameter's values until then, in each set that has it.
    """
    if _is_numeric(value) or not all(map(_is_numeric, before)):
        return ""
    kept = ", ".join(map(repr, dict.fromkeys(before)))
    return (
        f"{value!r} is no number, which it was ({kept}): the component declares no type, and one "
        "that expects a number takes its default instead, without an error"
    )


def _is_numeric(value: str) -> bool:
    return all(re.fullmatch(_NUMBER, word.strip()) for word in value.split(","))


def _test(constraint: str) -> Callable[[float], bool] | None:
    both = _BOTH_SIDES.fullmatch(constraint)
    if both:
        low, first, second, high = both.groups()
        return lambda x: _COMPARE[first](float(low), x) and _COMPARE[second](x, float(high))
    bound = _ONE_SIDE.fullmatch(constraint)
    if bound is None:
        return None
    after, right, left, before = bound.groups()
    if after:
        return lambda x: _COMPARE[after](x, float(right))
    return lambda x: _COMPARE[before](float(left), x)


_log = Log("uoarm.rtm")


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
        except (
            SDOPackage.InvalidParameter,
            SDOPackage.NotAvailable,
            SDOPackage.InternalError,
        ) as error:
            text = ": ".join(filter(None, (what, type(error).__name__, error.description)))
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
    sets = {str(entry.id): properties_of(entry.configuration_data) for entry in listing}
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


@define(eq=False)
class _Activation:
    """One component that channels need ACTIVE.

    Attributes:
        is_ours: whether we have activated it.
        changing: held while the component is called: one that is about to be deactivated must not
            count as active for a channel that opens.
    """

    owner: Activations
    peer: PeerComponent
    users: set[Channel] = field(factory=set)
    is_ours: bool = False
    changing: threading.Lock = field(factory=threading.Lock)

    def check(self) -> None:
        """Deactivate the component where we activated it and no open channel needs it."""
        with self.changing:
            self.owner.end(self)


class Activations:
    """Counts which channels need which component ACTIVE.

    A component that was ACTIVE before stays so afterwards: only what we began is ended.

    Args:
        seconds: limit of each call.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        # Guards the table and who uses what, from channels that open in any thread. Never held
        # while a component is called.
        self._guard = threading.Lock()
        self._known: dict[str, _Activation] = {}

    def enter(self, channel: Channel, peer: PeerComponent, options: RtmEndpointOptions) -> None:
        """Have a component ACTIVE while a channel is open, where its endpoint asks for that.

        One that has failed (ERROR) is reset before, where the endpoint allows it.

        Raises:
            BridgeError: it cannot be activated.
        """
        if not options.activate:
            return
        with self._guard:
            known = self._known.setdefault(peer.path, _Activation(self, peer))
            known.users.add(channel)  # from here on it stays in the table
        try:
            with known.changing:
                state = state_of(peer, self._seconds)
                if state == "error" and options.reset:
                    change(peer, "reset", self._seconds, there_is_fine=True)
                if state != "active":
                    change(peer, "activate", self._seconds, there_is_fine=True)
                    known.peer, known.is_ours = peer, True
        except BridgeError:
            with self._guard:
                known.users.discard(channel)
            raise

    def checks(self) -> list[Check]:
        """Return what there is to do, of each component on its own."""
        with self._guard:
            entries = list(self._known.values())
        return [known.check for known in entries if not self._is_used(known)]

    def leave(self, channel: Channel) -> None:
        """Deactivate what we activated and no other channel than this one needs."""
        with self._guard:
            found = [known for known in self._known.values() if channel in known.users]
            for known in found:
                known.users.discard(channel)
        for known in found:
            if not self._is_used(known):  # else it is not waited for, as it may hang
                known.check()

    def tick(self) -> None:
        """Deactivate what we activated and no channel needs."""
        for check in self.checks():
            check()

    def end(self, known: _Activation) -> None:
        """Deactivate one that no channel needs, and leave it out; the caller holds its lock."""
        if self._is_used(known):
            return
        peer = known.peer
        if known.is_ours:
            known.is_ours = False
            try:
                if state_of(peer, self._seconds) != "error":  # which is not active either
                    change(peer, "deactivate", self._seconds, there_is_fine=True)
            except BridgeError as error:
                _log.warning("component %s could not be deactivated: %s", peer.path, error)
        with self._guard:
            if not known.users and self._known.get(peer.path) is known:
                del self._known[peer.path]

    def _is_used(self, known: _Activation) -> bool:
        with self._guard:
            # One that is being closed needs it still: a component that is not ACTIVE drops the
            # stop message without a word.
            known.users = {user for user in known.users if user.is_in_use}
            return bool(known.users)
