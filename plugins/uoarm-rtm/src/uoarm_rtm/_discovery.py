"""Everything that is visible now, as components with endpoints and structures."""

from __future__ import annotations

import contextlib

from uoarm.bridge import Description, Discovered
from uoarm.errors import BridgeError
from uoarm.model import Endpoint, Role
from uoarm_rtm import _control
from uoarm_rtm._configuration import limits
from uoarm_rtm._directory import Directory
from uoarm_rtm._faults import corba_errors
from uoarm_rtm._options import CONFIGURATION, LIFECYCLE
from uoarm_rtm._peer import PeerComponent, PeerPort, contexts_of, state_of
from uoarm_rtm._service_call import described
from uoarm_rtm._types import Types

__all__ = ["discovered"]

_ROLES = {"DataOutPort": Role.OUTPUT, "DataInPort": Role.INPUT}


def discovered(
    bridge: str, directory: Directory, types: Types, seconds: float
) -> tuple[Discovered, ...]:
    """Return every component that has a name; those that do not answer have no endpoints."""
    peers, silent = directory.peers()
    found = [_component(bridge, peer, types, seconds) for peer in peers]
    for path, condition in silent:
        found.append(Discovered(path, (), condition))
    return tuple(sorted(found, key=lambda item: item.name))


def _component(bridge: str, peer: PeerComponent, types: Types, seconds: float) -> Discovered:
    endpoints: list[tuple[Endpoint, Description]] = []
    state, rate = _state(peer, seconds)
    remarks = [f"{peer.type_name}, {state}"]
    for port in peer.ports:
        role = _ROLES.get(port.kind)
        if role is None:
            continue
        address = (peer.path, port.name, port.data_type)
        description, remark = _description(port, types)
        remarks += [remark] if remark else []
        endpoints.append((Endpoint(bridge, peer.path, role, address, port=port.name), description))
    for port in peer.ports:
        for interface in port.interfaces:
            if interface.provided:
                address = (peer.path, port.name, interface.type)
                description, remark = _service(interface.type, types)
                remarks += [remark] if remark else []
                endpoint = Endpoint(bridge, peer.path, Role.SERVICE, address, port=port.name)
                endpoints.append((endpoint, description))
    with contextlib.suppress(BridgeError):  # it has none, or the state says why
        parameters = limits(peer, seconds)
        remarks += [f"parameters {parameters}"] if parameters else []
    for name, request, reply in (
        (LIFECYCLE, _control.LIFECYCLE_REQUEST, _control.LIFECYCLE_REPLY),
        (CONFIGURATION, _control.CONFIGURATION_REQUEST, _control.CONFIGURATION_REPLY),
    ):
        endpoint = Endpoint(bridge, peer.path, Role.SERVICE, (peer.path, name), port=name)
        endpoints.append((endpoint, Description(request=request, reply=reply)))
    given = [item.name for item in peer.ports if _ROLES.get(item.kind) is Role.OUTPUT]
    rates = {} if rate is None else dict.fromkeys(given, rate)
    return Discovered(peer.path, tuple(endpoints), "; ".join(remarks), rates)


def _description(port: PeerPort, types: Types) -> tuple[Description, str]:
    if port.takes_events:
        return Description(), f"port {port.name!r} takes the events of a state machine"
    try:
        return Description(message=types.structure(port.data_type)), ""
    except BridgeError as error:
        return Description(), str(error)


def _service(type_name: str, types: Types) -> tuple[Description, str]:
    try:
        return described(*types.interface(type_name)), ""
    except BridgeError as error:
        return Description(), str(error)


def _state(peer: PeerComponent, seconds: float) -> tuple[str, float | None]:
    """Return the state in words, and how often a second its execution context runs it."""
    try:
        contexts = contexts_of(peer, seconds)
        text = f"{state_of(peer, seconds)}, {len(contexts)} execution context"
    except BridgeError as error:
        return str(error), None
    rate: float | None = None
    with contextlib.suppress(BridgeError), corba_errors(f"component {peer.path!r}: its rate"):
        rate = float(contexts[0].get_rate()) if contexts else None
    return text + "s"[: len(contexts) != 1], rate or None  # 0: when something happens
