# ruff: noqa: SLF001 - CORBA begins the names of its own operations with an underscore
"""An RT-Component of our own: what other components, RT System Editor and rtshell see of us.

orb = Orb("127.0.0.1", call_seconds=2.0)
component = RtComponent(orb, ComponentProfile("Counter0"))
out = component.add_out_port("count", "RTC::TimedLong", Types())
component.bind([NamingService(orb, "localhost:2809", 2.0)])
out.write({"tm": {"sec": 1, "nsec": 0}, "data": 1})
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from _uoarm_rtm_stubs import RTC, OpenRTM__POA, SDOPackage
from attrs import field, frozen

from uoarm.bridge import on_failure
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Message
from uoarm_rtm._data_ports import InPort, OutPort
from uoarm_rtm._naming import NamingService
from uoarm_rtm._orb import Orb, corba_errors
from uoarm_rtm._port_servant import PortServant
from uoarm_rtm._servants import Callbacks, ComponentLifecycle, ConfigurationServant, ContextServant
from uoarm_rtm._types import Types

__all__ = ["Callbacks", "ComponentProfile", "NamingService", "Orb", "RtComponent", "Types"]

_CONTEXT = 0
_OK = RTC.RTC_OK


@frozen
class ComponentProfile:
    """What a component says of itself."""

    name: str
    type_name: str = "Uoarm"
    description: str = "functions of uoarm"
    version: str = "0.1.0"
    vendor: str = "uoarm"
    category: str = "Generic"
    configuration: Mapping[str, Mapping[str, str]] = field(factory=dict, hash=False)


class RtComponent(OpenRTM__POA.DataFlowComponent):  # type: ignore[misc]  # generated
    """A component with one execution context of its own.

    Made inactive; a tool or another program activates it. Callbacks run in threads of the ORB.

    Args:
        orb: where it is served.
        profile: what it says of itself.
        callbacks: what it does at changes of its lifecycle.
        rate: steps a second for `callbacks.executed`; 0 for none.
        configured: called with the configuration in force when it changes.
        seconds: limit of every call to other components.
    """

    def __init__(
        self,
        orb: Orb,
        profile: ComponentProfile,
        *,
        callbacks: Callbacks = Callbacks(),  # noqa: B008 - a frozen value
        rate: float = 0.0,
        configured: Callable[[Mapping[str, str]], None] = lambda _: None,
        seconds: float = 2.0,
    ) -> None:
        self.profile = profile
        self.lifecycle = ComponentLifecycle(callbacks)
        self._orb = orb
        self._seconds = seconds
        # Guards the list of ports: profiles are asked for in threads of the ORB.
        self._lock = threading.Lock()
        self._ports: list[PortServant] = []
        self._bound: list[tuple[NamingService, str]] = []
        self._exiting = threading.Event()
        self._context = ContextServant(orb, self.lifecycle, rate)
        self._configuration = ConfigurationServant(orb, profile.configuration, configured)
        self.reference = orb.serve(self)
        self._context.component = self.reference

    @property
    def path(self) -> str:
        """The name under which it is bound when no other is given."""
        return f"{self.profile.name}.rtc"

    @property
    def ports(self) -> tuple[PortServant, ...]:
        """The ports there are now."""
        with self._lock:
            return tuple(self._ports)

    def add_in_port(
        self,
        name: str,
        type_id: str,
        types: Types,
        take: Callable[[Message], None],
        rate: float = 0.0,
        unreadable: Callable[[str], object] = lambda _: None,
    ) -> InPort:
        """Add a port that takes messages; `take` gets them while the component is ACTIVE.

        With a `rate`, OutPorts that wait to be asked are asked so often a second. What comes while
        it is not ACTIVE is counted in `dropped`; `unreadable` gets why a message is none.

        Raises:
            BridgeError: the type is not known, or there is another port of that name.
        """

        def taken(message: Message) -> None:
            if self.lifecycle.state == RTC.ACTIVE_STATE:
                take(message)
            else:
                port.dropped += 1

        codec = types.codec(type_id)
        full = f"{self.profile.name}.{name}"
        port = InPort(self._orb, full, codec, taken, self._seconds, rate, unreadable)
        self.add_port(port)
        return port

    def add_out_port(self, name: str, type_id: str, types: Types) -> OutPort:
        """Add a port that emits messages.

        Raises:
            BridgeError: the type is not known, or there is another port of that name.
        """
        codec = types.codec(type_id)
        port = OutPort(self._orb, f"{self.profile.name}.{name}", codec, self._seconds)
        self.add_port(port)
        return port

    def add_port(self, port: PortServant) -> None:
        """Add any port.

        Raises:
            BridgeError: there is another one of its name; this one is closed.
        """
        port.owner = self.reference
        with on_failure(port.close), self._lock:
            if any(known.name == port.name for known in self._ports):
                component, _, name = port.name.rpartition(".")
                text = f"component {component!r} has a port {name!r} already: give one another name"
                raise BridgeError(text, FailureReason.BAD_ENDPOINT)
            self._ports.append(port)

    def remove_port(self, port: PortServant) -> None:
        """Disconnect and remove a port."""
        with self._lock:
            if port in self._ports:
                self._ports.remove(port)
        port.close()

    def bind(self, services: Sequence[NamingService], path: str | None = None) -> None:
        """Become visible in naming services; may be repeated after one came back empty.

        Raises:
            BridgeError: a service does not answer.
        """
        for service in services:
            bound = service, path or self.path
            if bound not in self._bound:
                self._bound.append(bound)
            service.bind(bound[1], self.reference)

    def wait_for_exit(self, seconds: float | None = None) -> bool:
        """Wait until a client calls `exit` on the component; returns whether that came."""
        return self._exiting.wait(seconds)

    def close(self) -> None:
        """Disappear: from naming services, then from connectors, then altogether."""
        for service, path in self._bound:
            with suppress(Exception):  # a service that is gone has forgotten us
                service.unbind(path, self.reference)
        for port in list(self._ports):
            self.remove_port(port)
        self._context.close()
        self._configuration.close()
        self._orb.withdraw(self.reference)

    def get_component_profile(self) -> Any:
        """Return the profile (CORBA operation)."""
        profile = self.profile
        words = (
            profile.type_name,
            profile.description,
            profile.version,
            profile.vendor,
            profile.category,
        )
        with self._lock:
            ports = [port.get_port_profile() for port in self._ports]
        return RTC.ComponentProfile(profile.name, *words, ports, None, [])

    def get_ports(self) -> list[Any]:
        """Return references of the ports (CORBA operation)."""
        with self._lock:
            return [port.reference for port in self._ports]

    def get_configuration(self) -> Any:
        """Return the configuration sets (CORBA operation)."""
        return self._configuration.reference

    def initialize(self) -> Any:
        """Answer that this has happened (CORBA operation)."""
        return RTC.PRECONDITION_NOT_MET

    def finalize(self) -> Any:
        """Refuse while a context drives the component (CORBA operation)."""
        return RTC.PRECONDITION_NOT_MET

    def exit(self) -> Any:
        """Ask the owner of the component to end it (CORBA operation)."""
        self._exiting.set()
        return _OK

    def is_alive(self, exec_context: Any) -> bool:
        """Whether it takes part in a context (CORBA operation)."""
        return self._is_mine(exec_context)

    def attach_context(self, exec_context: Any) -> int:
        """Refuse: it has its context (CORBA operation)."""
        return _CONTEXT if self._is_mine(exec_context) else -1

    def detach_context(self, exec_handle: int) -> Any:
        """Refuse: it keeps its context (CORBA operation)."""
        return RTC.UNSUPPORTED if exec_handle == _CONTEXT else RTC.BAD_PARAMETER

    def get_context(self, exec_handle: int) -> Any:
        """Return the context of a handle (CORBA operation)."""
        return self._context.reference if exec_handle == _CONTEXT else None

    def get_owned_contexts(self) -> list[Any]:
        """Return the one context (CORBA operation)."""
        return [self._context.reference]

    def get_participating_contexts(self) -> list[Any]:
        """Return nothing: it is in no context of others (CORBA operation)."""
        return []

    def get_context_handle(self, context: Any) -> int:
        """Return the handle of a context, -1 for any other (CORBA operation)."""
        return _CONTEXT if self._is_mine(context) else -1

    def get_sdo_id(self) -> str:
        """Return the instance's name (CORBA operation)."""
        return self.profile.name

    def get_sdo_type(self) -> str:
        """Return the description (CORBA operation)."""
        return self.profile.description

    def get_device_profile(self) -> Any:
        """Return what the component is, as a device (CORBA operation)."""
        profile = self.profile
        words = (profile.category, profile.vendor, profile.type_name, profile.version)
        return SDOPackage.DeviceProfile(*words, [])

    def get_service_profiles(self) -> list[Any]:
        """Return nothing: it has no SDO services (CORBA operation)."""
        return []

    def get_service_profile(self, identifier: str) -> Any:
        """Raise: it has no SDO services (CORBA operation)."""
        raise SDOPackage.InvalidParameter(f"there is no service {identifier!r}")

    def get_sdo_service(self, identifier: str) -> Any:
        """Raise: it has no SDO services (CORBA operation)."""
        raise SDOPackage.InvalidParameter(f"there is no service {identifier!r}")

    def get_monitoring(self) -> Any:
        """Raise: it has no monitoring (CORBA operation)."""
        raise SDOPackage.InterfaceNotImplemented("there is no monitoring")

    def get_organizations(self) -> list[Any]:
        """Return nothing: it is in no organisation (CORBA operation)."""
        return []

    def get_owned_organizations(self) -> list[Any]:
        """Return nothing: it owns no organisation (CORBA operation)."""
        return []

    def get_status_list(self) -> list[Any]:
        """Return nothing: it keeps no status list (CORBA operation)."""
        return []

    def get_status(self, name: str) -> Any:
        """Raise: it keeps no status list (CORBA operation)."""
        raise SDOPackage.InvalidParameter(f"there is no status {name!r}")

    def _is_mine(self, context: Any) -> bool:
        with corba_errors("comparing contexts"):
            return context is not None and bool(self._context.reference._is_equivalent(context))
