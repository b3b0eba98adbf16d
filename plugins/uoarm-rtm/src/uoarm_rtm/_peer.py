"""A component of another program: its profile, its ports and its state, read in one go."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from _uoarm_rtm_stubs import RTC, SDOPackage
from attrs import field, frozen
from omniORB import CORBA
from omniORB import any as corba_any

from uoarm.errors import BridgeError, FailureReason
from uoarm_rtm._faults import corba_errors
from uoarm_rtm._orb import limit, narrowed

__all__ = [
    "PeerComponent",
    "PeerPort",
    "PortInterface",
    "contexts_of",
    "pairs",
    "peer_at",
    "properties_of",
    "state_of",
]


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
        for item in self.ports:
            if name in {item.name, f"{self.instance}.{item.name}"}:
                return item
        names = ", ".join(item.name for item in self.ports) or "none"
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
    return [narrowed(item, RTC.ExecutionContext, seconds, what) for item in found]


def state_of(peer: PeerComponent, seconds: float) -> str:
    """Return `created`, `inactive`, `active` or `error`; `none` without an execution context."""
    contexts = contexts_of(peer, seconds)
    if not contexts:
        return "none"
    with corba_errors(f"component {peer.path!r}: reading its state"):
        state = contexts[0].get_component_state(peer.reference)
    return str(state).removesuffix("_STATE").lower()
