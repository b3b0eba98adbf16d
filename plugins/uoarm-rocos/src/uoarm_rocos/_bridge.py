"""The bridge: devices by name, each begun when it is first asked for."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial

from uoarm.bridge import (
    Bridge,
    Capabilities,
    Delivery,
    Description,
    Discovered,
    HealthReason,
    ServiceStructures,
    Sink,
    Source,
)
from uoarm.errors import BridgeError, FailureReason, UoarmError
from uoarm.model import Endpoint, Health, Message, MessageStructure
from uoarm_rocos._catalogue import Api, DeviceCatalogue, Direction, difference
from uoarm_rocos._catalogue_xml import load_catalogue
from uoarm_rocos._channels import SinkChannel, SourceChannel
from uoarm_rocos._codec import XmlCodec
from uoarm_rocos._device import Device, find
from uoarm_rocos._discovery import listing
from uoarm_rocos._framing import SERIAL_LIMITS, TCP_LIMITS, LengthFramer, StuffedFramer
from uoarm_rocos._options import DeviceOptions, RocosOptions, address_of
from uoarm_rocos._profile import Changed, LineParts, ProfileDevice
from uoarm_rocos._structure import describe
from uoarm_rocos._transport import transport_for
from uoarm_rocos.devices._blood_pressure import Monitor
from uoarm_rocos.devices._oximeters import (
    CONTEC_PERIOD,
    NONIN_1_PERIOD,
    NONIN_2_PERIOD,
    ContecDecoder,
    Nonin1Decoder,
    Nonin2Decoder,
    OximeterDecoder,
    StreamDevice,
    oximeter_catalogue,
)
from uoarm_rocos.speech import Engine, EspeakEngine, FestivalEngine, Speech

_OXIMETERS: dict[str, tuple[str, float, Callable[[], OximeterDecoder]]] = {
    "contec-cms50dplus": ("Contec CMS50D+", CONTEC_PERIOD, ContecDecoder),
    "nonin-1": ("Nonin, serial format 1", NONIN_1_PERIOD, Nonin1Decoder),
    "nonin-2": ("Nonin, serial format 2", NONIN_2_PERIOD, Nonin2Decoder),
}
_ENGINES: dict[str, Callable[[], Engine]] = {"espeak": EspeakEngine, "festival": FestivalEngine}
_IS_POSIX = os.name == "posix"
MakeWire = Callable[[DeviceOptions], LineParts]


def xml_wire(options: DeviceOptions) -> LineParts:
    """Return the profile's own parts: lengths over TCP, stuffing and CRC on every other line."""
    transport = transport_for(options.url, options.line)
    if options.url.startswith("tcp://"):
        return LineParts(transport, LengthFramer, XmlCodec(TCP_LIMITS), prompt=_IS_POSIX)
    is_port = "://" not in options.url
    return LineParts(
        transport, StuffedFramer, XmlCodec(SERIAL_LIMITS), prompt=_IS_POSIX and is_port
    )


def make_device(name: str, options: DeviceOptions, wire: MakeWire, changed: Changed) -> Device:
    """Make a device and begin to connect it.

    Raises:
        UoarmError: its catalogue cannot be read, or its driver lacks a package.
    """
    if options.driver == "profile":
        catalogue = load_catalogue(options.catalogue) if options.catalogue else None
        return ProfileDevice(name, wire(options), options.timing, catalogue, changed)
    if options.driver in _ENGINES:
        return Speech(name, _ENGINES[options.driver](), options)
    transport = transport_for(options.url, options.line)
    if options.driver == "and-ua767pbt":
        return Monitor(name, transport, options.timing, changed)
    text, period, decoder = _OXIMETERS[options.driver]
    catalogue = oximeter_catalogue(text, period)
    return StreamDevice(name, catalogue, decoder, transport, options.timing)


_OPEN_SECONDS = 5.0
_DISCOVER_SECONDS = 2.0


class RocosBridge(Bridge):
    """Devices with catalogues, each on a line of its own.

    Messages of one device are delivered in one thread of its own, in which the receiver may call
    the same device. A device is connected when it is first asked for and stays connected until
    the bridge is closed.

    Args:
        wire: makes the parts of a line; replaces the plain-XML profile.
    """

    capabilities = Capabilities(discover=True, call=True)

    def __init__(self, name: str, options: RocosOptions, wire: MakeWire = xml_wire) -> None:
        super().__init__(name, options)
        self._device_options = options.devices
        self._wire = wire
        # Guards the devices between callers of the bridge and `close`: each is made once, and none
        # after the bridge was closed. Reading the dictionary needs no lock.
        self._making = threading.Lock()
        self._devices: dict[str, Device] = {}
        self._described: dict[tuple[str, ...], Api] = {}
        # Of each device, the services as components were described: by component and name.
        self._services: dict[str, dict[tuple[str, str], Api]] = {}

    def facts(self) -> Mapping[str, object]:
        """Return how often the threads of lines turned for nothing."""
        devices = tuple(self._devices.values())
        return {"empty_turns": sum(device.empty_turns for device in devices)}

    def _describe(self, endpoint: Endpoint) -> Description:
        name, api_name, direction = address_of(endpoint)
        api = self._find(endpoint)
        if direction is None:
            self._described[name, api_name] = api
            self._services.setdefault(name, {})[endpoint.component, api_name] = api
        return describe(api, direction)

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        api = self._checked(endpoint, structure)
        channel = SourceChannel(endpoint)
        report = partial(self.report, channel=channel)
        channel.flow = self._device(endpoint).open_output(api, deliver, report, _OPEN_SECONDS)
        return channel

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        api = self._checked(endpoint, structure)
        channel = SinkChannel(endpoint)
        report = partial(self.report, channel=channel)
        channel.flow = self._device(endpoint).open_input(api, report, _OPEN_SECONDS)
        return channel

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        del structures  # the catalogue has them
        # What was described has an address that was checked.
        api = None if endpoint.options else self._described.get(endpoint.address)
        device = self._devices.get(endpoint.address[0]) if api is not None else None
        if api is not None and device is not None:
            return device.call(api, message, timeout)
        began = time.monotonic()
        api = self._find(endpoint, timeout)
        left = max(0.0, timeout - (time.monotonic() - began))
        return self._device(endpoint).call(api, message, left)

    def _keeps_time(self, endpoint: Endpoint) -> bool:
        device = self._devices.get(endpoint.address[0]) if endpoint.address else None
        return device is not None and device.is_prompt

    def _discover(self) -> tuple[Discovered, ...]:
        end = time.monotonic() + _DISCOVER_SECONDS
        devices: dict[str, Device] = {}
        found, away = list[Discovered](), list[UoarmError]()
        for name in self._device_options:
            try:
                devices[name] = self._named(name)
            except UoarmError as error:  # of this one: the others are there all the same
                away.append(error)
        for name, device in devices.items():
            try:
                catalogue = device.catalogue(max(0.0, end - time.monotonic()))
            except BridgeError as error:  # that it is away is what a discovery is to find out
                away.append(error)
            else:
                found.append(listing(self.name, name, catalogue))
        if away and not found:
            raise away[0]
        return tuple(found)

    def _close(self) -> None:
        with self._making:
            devices, self._devices = list(self._devices.values()), {}
        for device in devices:  # together: each may be waiting for one that does not answer
            device.stop()
        for device in devices:
            device.close()

    def _device(self, endpoint: Endpoint) -> Device:
        return self._named(address_of(endpoint)[0])

    def _named(self, name: str) -> Device:
        options = self._device_options.get(name)
        if options is None:
            known = ", ".join(self._device_options)
            text = f"bridge {self.name!r} has no device {name!r}; its options name {known}"
            raise BridgeError(text, FailureReason.NOT_FOUND)
        device = self._devices.get(name)
        if device is not None and not self.closed:
            return device  # without the lock, within which another device may be made
        with self._making:
            if self.closed:
                raise BridgeError(f"bridge {self.name!r} is closed", FailureReason.CLOSED)
            device = self._devices.get(name)
            if device is None:
                changed = partial(self._device_changed, name)
                device = self._devices[name] = make_device(name, options, self._wire, changed)
            return device

    def _find(self, endpoint: Endpoint, timeout: float | None = None) -> Api:
        name, api, direction = address_of(endpoint)
        wait = self._device_options[name].timing.wait if name in self._device_options else 0.0
        limit = wait if timeout is None else min(wait, timeout)
        return find(self._device(endpoint).catalogue(limit), api, direction)

    def _checked(self, endpoint: Endpoint, structure: MessageStructure) -> Api:
        """Return the API if it still is what the plan was checked with."""
        api = self._find(endpoint)
        direction = address_of(endpoint)[2]
        assert direction in {Direction.INPUT, Direction.OUTPUT}
        now = describe(api, direction).message
        if structure.native_type == f"{api.name}.{direction.value}" and structure != now:
            text = f"{endpoint}: the device has another catalogue than the one that was checked"
            raise BridgeError(text, FailureReason.CONTRACT)
        return api

    def _device_changed(
        self, device: str, health: Health, cause: str, catalogue: DeviceCatalogue | None
    ) -> None:
        """Report what holds for services: flows report their own health."""
        changes: dict[str, list[str]] = {}
        for (component, _), api in list(self._services.get(device, {}).items()):
            found = changes.setdefault(component, [])
            if catalogue is not None and (change := difference(api, catalogue)):
                found.append(change)
        for component, found in changes.items():
            worse, why = health, cause
            if found:
                worse, why = Health.LOST, f"{HealthReason.REFUSED.value}: {'; '.join(found)}"
            self.report(worse, why, component=component)
