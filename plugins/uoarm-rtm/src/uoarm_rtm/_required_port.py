"""The data port that an endpoint means, or why it cannot be had: all of it before connecting."""

from __future__ import annotations

from attrs import evolve

from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Role
from uoarm_rtm._options import PortAddress, RtmEndpointOptions
from uoarm_rtm._peer import PeerComponent, PeerPort
from uoarm_rtm._types import Types

__all__ = ["is_big_in_cpp", "required_port"]

_KINDS = {Role.OUTPUT: "DataOutPort", Role.INPUT: "DataInPort"}
_MISREAD = (Role.OUTPUT, "push"), (Role.INPUT, "pull")


def required_port(
    peer: PeerComponent,
    role: Role,
    address: PortAddress,
    options: RtmEndpointOptions,
    types: Types,
) -> PeerPort:
    """Return the port of an address, with the data type that goes over it.

    Raises:
        BridgeError: NOT_FOUND, where there is none; BAD_ENDPOINT or REFUSED, where it is another
            one than the configuration says; UNSUPPORTED, where we do not speak as it does.
    """
    port = peer.port(address.port)
    where = f"port {port.name!r} of component {peer.path!r}"
    if port.kind != _KINDS[role]:
        kind = port.kind or "nameless kind"
        text = f"{where} is a {kind}, but an {role.value} needs a {_KINDS[role]}"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    if port.interface_types and "corba_cdr" not in port.interface_types:
        text = (
            f"{where} offers the interface types {', '.join(port.interface_types)}, and we speak "
            "corba_cdr: let the component offer it, too (in its rtc.conf: `provider_types` and "
            "`consumer_types` of the port)"
        )
        raise BridgeError(text, FailureReason.UNSUPPORTED)
    if port.takes_events:
        port = _event(port, where, address, options)
    elif options.event:
        text = f"{where} takes {port.data_type}, and no events: leave the option `event` out"
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    if address.type and not types.same(address.type, port.data_type):
        text = (
            f"{where} carries {port.data_type}, the configuration says {address.type}: "
            "correct the endpoint"
        )
        raise BridgeError(text, FailureReason.REFUSED)
    if is_big_in_cpp(peer, options) and (role, options.flow) in _MISREAD:
        text = (
            f"{where}: components in C++ take no notice of `endian` where they push or ask: "
            "leave it out"
        )
        raise BridgeError(text, FailureReason.REFUSED)
    return port


def is_big_in_cpp(peer: PeerComponent, options: RtmEndpointOptions) -> bool:
    """Whether big-endian data is asked of a component that may not notice."""
    return options.endian == "big" and peer.language == "C++"


def _event(
    port: PeerPort, where: str, address: PortAddress, options: RtmEndpointOptions
) -> PeerPort:
    """Return the port of a state machine as that of one event, which has a data type."""
    if not address.type or not options.event:
        text = (
            f"{where} takes the events of a state machine (type any): name the event in the "
            "option `event`, and its data type as third part of the endpoint"
        )
        raise BridgeError(text, FailureReason.BAD_ENDPOINT)
    return evolve(port, data_type=address.type)
