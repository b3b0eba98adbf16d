"""Components of other programs: profile, ports and state, and connections to their ports.

Only the remote port stands in the profile of a connector; what we serve goes along as a
stringified reference, since components in Python refuse object references (observed at
OpenRTM-aist-Python).

What we connect is ours to end: each connector names its maker in its properties, and stands in
the journal for as long as it may exist, so that the next process ends what this one could not.
"""

from __future__ import annotations

import contextlib
import threading
import time
import uuid
from collections.abc import Mapping
from itertools import count
from typing import Any

from _uoarm_rtm_stubs import RTC, SDOPackage
from attrs import field, frozen
from omniORB import CORBA
from omniORB import any as corba_any

from uoarm.bridge import Backoff
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm_rtm._journal import NAME, PROCESS, JournalEntry, end_connector, end_leftovers, journal
from uoarm_rtm._options import RtmEndpointOptions
from uoarm_rtm._orb import Orb, calls, corba_errors, limit, narrowed


@frozen
class PortInterface:
    """One service at a CorbaPort."""

    name: str
    type: str
    provided: bool


@frozen
class PeerPort:
    """One port of a component.

    Attributes:
        kind: `DataInPort`, `DataOutPort`, `CorbaPort`, or whatever the component says.
        data_type: as the component writes it; empty for a CorbaPort.
    """

    name: str
    reference: Any
    kind: str
    data_type: str
    properties: Mapping[str, str] = field(hash=False)
    interfaces: tuple[PortInterface, ...] = ()

    @property
    def interface_types(self) -> tuple[str, ...]:
        """The ways in which a data port moves data; empty where it does not say."""
        words = self.properties.get("dataport.interface_type", "").lower().split(",")
        return tuple(word.strip() for word in words if word.strip())

    @property
    def takes_events(self) -> bool:
        """Whether it is the port of a state machine: each event has a data type of its own."""
        return self.kind == "DataInPort" and self.data_type.strip().lower() in {"any", "corba::any"}


@frozen
class PeerComponent:
    """One component, as its profile describes it.

    Attributes:
        language: `C++`, `Python`, `Java`, or empty for a component that does not say.
    """

    path: str
    reference: Any
    instance: str
    type_name: str
    ports: tuple[PeerPort, ...]
    language: str = ""

    def port(self, name: str) -> PeerPort:
        """Return a port by its name, with or without the component's before it.

        Raises:
            BridgeError: NOT_FOUND, with the ports that there are.
        """
        for port in self.ports:
            if name in {port.name, f"{self.instance}.{port.name}"}:
                return port
        names = ", ".join(port.name for port in self.ports) or "none"
        text = f"component {self.path!r} has no port {name!r}; it has {names}"
        raise BridgeError(text, FailureReason.NOT_FOUND)


def peer_at(path: str, reference: Any, seconds: float) -> PeerComponent:
    """Read the profile of the component behind a reference.

    Raises:
        BridgeError: it is gone, hangs, or is not a component.
    """
    what = f"component {path!r}"
    component = narrowed(reference, RTC.RTObject, seconds, what)
    with corba_errors(f"{what}: reading its profile"):
        profile = component.get_component_profile()
    ports = tuple(
        _port(port_profile, profile.instance_name, seconds)
        for port_profile in profile.port_profiles
    )
    language = properties_of(profile.properties).get("language", "")
    return PeerComponent(path, component, profile.instance_name, profile.type_name, ports, language)


def _port(profile: Any, instance: str, seconds: float) -> PeerPort:
    properties = properties_of(profile.properties)
    interfaces = tuple(
        PortInterface(
            interface.instance_name, interface.type_name, interface.polarity == RTC.PROVIDED
        )
        for interface in profile.interfaces
    )
    return PeerPort(
        name=profile.name.removeprefix(f"{instance}."),
        reference=limit(profile.port_ref, seconds),
        kind=properties.get("port.port_type", ""),
        data_type=properties.get("dataport.data_type", ""),
        properties=properties,
        interfaces=interfaces,
    )


def properties_of(listing: Any) -> dict[str, str]:
    """Return the values of a property list that are strings; others say nothing to us."""
    found = {}
    for item in listing:
        try:
            value = item.value.value()
        except (CORBA.Exception, AttributeError):
            continue
        if isinstance(value, str):
            found[item.name] = value
    return found


def pairs(properties: Mapping[str, str]) -> list[Any]:
    """Return a property list as CORBA wants it."""
    return [
        SDOPackage.NameValue(name, corba_any.to_any(value)) for name, value in properties.items()
    ]


def contexts_of(peer: PeerComponent, seconds: float) -> list[Any]:
    """Return the execution contexts that a component owns, then those it takes part in."""
    what = f"component {peer.path!r}: execution contexts"
    with corba_errors(what):
        owned = peer.reference.get_owned_contexts()
        found = owned or peer.reference.get_participating_contexts()
    return [narrowed(context, RTC.ExecutionContext, seconds, what) for context in found]


def state_of(peer: PeerComponent, seconds: float) -> str:
    """Return `created`, `inactive`, `active` or `error`; `none` without an execution context."""
    contexts = contexts_of(peer, seconds)
    if not contexts:
        return "none"
    with corba_errors(f"component {peer.path!r}: reading its state"):
        state = contexts[0].get_component_state(peer.reference)
    return str(state).removesuffix("_STATE").lower()


_UNDO_SECONDS = 60.0
_UNDO_BACKOFF = Backoff(first=0.05, most=1.0)

_MEANINGS = {
    "RTC_ERROR": "it failed, or does not know what was asked",
    "BAD_PARAMETER": "something asked is unknown to it",
    "UNSUPPORTED": "it cannot do what was asked",
    "OUT_OF_RESOURCES": "it has no resources left",
    "PRECONDITION_NOT_MET": "it refuses in its present state, or is connected so already",
}


def connector_properties(options: RtmEndpointOptions, data_type: str) -> dict[str, str]:
    """Return the connector properties that an endpoint's options ask for."""
    order = "big,little" if options.endian == "big" else "little,big"
    return {
        "dataport.interface_type": "corba_cdr",
        "dataport.dataflow_type": options.flow,
        "dataport.subscription_type": options.subscription,
        "dataport.publisher.push_rate": f"{options.rate:g}",
        "dataport.push_rate": f"{options.rate:g}",
        "dataport.data_type": data_type,
        "dataport.serializer.cdr.endian": order,
        **options.requested_properties,
    }


class Connections:
    """Makes the connectors of one bridge; the first waits until what killed processes left ends.

    Args:
        name: of the bridge, which connectors carry.
        seconds: limit of each call.
    """

    def __init__(self, orb: Orb, name: str, seconds: float) -> None:
        self._orb = orb
        self._seconds = seconds
        self._properties = {NAME: name, PROCESS: journal().process}
        # Held while leftovers are ended: no connection is made before, from any thread.
        self._clearing = threading.Lock()
        self._cleared = False
        self._closed = threading.Event()

    def close(self) -> None:
        """Leave to the next process what could not be ended yet."""
        self._closed.set()

    def connect(
        self, where: str, properties: Mapping[str, str], port: PeerPort, *others: PeerPort
    ) -> Connector:
        """Connect ports.

        Args:
            where: the component's path and the port, for errors.
            properties: what the profile asks.
            port: the one that is asked.
            others: further ports of the connection.

        Raises:
            BridgeError: REFUSED with the port's answer; UNAVAILABLE when it is gone. Nothing
                stays connected.
            BridgeTimeoutError: no answer; a connection that comes about within a minute is ended.
        """
        with self._clearing:
            if not self._cleared:
                self._cleared = True
                end_leftovers(self._orb, self._seconds)
        references = [limit(end.reference, self._seconds) for end in (port, *others)]
        iors = tuple(self._orb.text(reference) for reference in references)
        properties = {**properties, **self._properties}
        return Connector(where, properties, references, iors, self._seconds, self._closed)


class Connector:
    """One connection; made by connecting, ended by `disconnect`. `Connections` makes them.

    Args:
        where: the component's path and the port, for errors.
        properties: what the profile asks.
        ports: of the connection, the one that is asked first; calls have their limits.
        iors: of the ports, for the journal.
        seconds: that a component may take to make it, from when on it answers.
        closed: is set when what may be made later is not ended any more.
    """

    def __init__(
        self,
        where: str,
        properties: Mapping[str, str],
        ports: list[Any],
        iors: tuple[str, ...],
        seconds: float,
        closed: threading.Event,
    ) -> None:
        self.id = f"uoarm-{uuid.uuid4()}"
        self._ports = ports
        self._where = where
        self._seconds, self._closed = seconds, closed
        profile = RTC.ConnectorProfile(self.id, self.id, ports, pairs(properties))
        journal().write(JournalEntry(self.id, iors, where))
        try:
            with corba_errors(f"connecting to {where}"):
                code, profile = ports[0].connect(profile)
        except BridgeTimeoutError:
            # Whether it will be connected is unknown: it is disconnected when it wakes up.
            threading.Thread(target=self._undo, name="uoarm-rtm-undo", daemon=True).start()
            raise
        except BridgeError:
            self._discard()
            raise
        if code != RTC.RTC_OK:
            self._discard()
            meaning = _MEANINGS.get(str(code), "an answer that the specification does not have")
            text = f"{where} refuses to connect: {code} ({meaning}); asked was {dict(properties)}"
            raise BridgeError(text, FailureReason.REFUSED)
        self.properties = properties_of(profile.properties)

    def published(self, *keys: str) -> str:
        """Return the first of these properties that a port has published.

        Raises:
            BridgeError: REFUSED when there is none; the connection is ended.
        """
        for key in keys:
            if self.properties.get(key):
                return self.properties[key]
        self._discard()
        text = f"{self._where} connected, but published none of {', '.join(keys)}"
        raise BridgeError(text, FailureReason.REFUSED)

    def alive(self, end: int = 0) -> bool:
        """Whether a port still has this connection; `end` counts ports from the one asked.

        Raises:
            BridgeError: the component is gone.
            BridgeTimeoutError: it hangs.
        """
        with corba_errors(f"looking at the connection to {self._where}"):
            profile = self._ports[end].get_connector_profile(self.id)
            return bool(profile.connector_id == self.id)

    def disconnect(self) -> None:
        """End the connection at every port; one that the other side has ended is fine.

        Raises:
            BridgeTimeoutError: a port did not answer; the next process tries again.
        """
        try:
            with corba_errors(f"disconnecting from {self._where}"):
                end_connector(self.id, self._ports)
        except BridgeTimeoutError:
            raise
        except BridgeError:
            return  # the ORB has ended before
        journal().erase(self.id)

    def _undo(self) -> None:
        """End a connection that may be made only later.

        The request to end it may overtake the one that makes it, as they come through different
        connections of TCP. So it is repeated, until there was one to end, or the component has
        answered for as long as it may take to make one.
        """
        until = time.monotonic() + _UNDO_SECONDS
        answers = False
        for attempt in count(1):
            try:
                with calls:
                    is_over = end_connector(self.id, self._ports)
            except CORBA.TIMEOUT:
                is_over = False
            except CORBA.Exception:
                return  # the ORB has ended; the journal has it for the next process
            else:
                if not answers:
                    answers, until = True, min(until, time.monotonic() + self._seconds)
            if is_over or (answers and time.monotonic() >= until):
                break
            if time.monotonic() >= until or self._closed.wait(_UNDO_BACKOFF.pause(attempt)):
                return
        journal().erase(self.id)

    def _discard(self) -> None:
        with contextlib.suppress(CORBA.Exception), calls:
            end_connector(self.id, self._ports)
            journal().erase(self.id)
