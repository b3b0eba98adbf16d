"""What devices offer, as a listing; and facts about this machine for `uoarm doctor`."""

from __future__ import annotations

import shutil
from importlib.metadata import PackageNotFoundError, version

from uoarm.bridge import Discovered, install_command
from uoarm.model import Endpoint, Role
from uoarm_rocos._catalogue import Api, ApiKind, DeviceCatalogue
from uoarm_rocos._options import address_of
from uoarm_rocos._structure import describe


def listing(bridge: str, device: str, catalogue: DeviceCatalogue) -> Discovered:
    """Return a device with an endpoint for each service, and for each way of each flow."""
    endpoints = [
        (endpoint, describe(api, address_of(endpoint)[2]))
        for api in catalogue.apis.values()
        for endpoint in _endpoints(bridge, device, api)
    ]
    return Discovered(device, tuple(endpoints), catalogue.device)


def _endpoints(bridge: str, device: str, api: Api) -> list[Endpoint]:
    if api.kind is ApiKind.SERVICE:
        roles = [Role.SERVICE]
    else:
        ways = ((Role.INPUT, api.input), (Role.OUTPUT, api.output))
        roles = [role for role, fields in ways if fields]
    return [Endpoint(bridge, device, role, (device, api.name), api.name) for role in roles]


def doctor() -> dict[str, str]:
    """Return what there is for devices and speech, name to finding; opens no port."""
    import serial  # noqa: PLC0415 - not needed to load the plugin
    from serial.tools.list_ports import comports  # noqa: PLC0415 - the same

    ports = [f"{port.device} ({port.description})" for port in comports()]
    try:
        espeak = f"espeakng-loader {version('espeakng-loader')} (GPL-3.0-or-later)"
    except PackageNotFoundError:
        espeak = f"not installed: {install_command('uoarm-rocos', 'speech')}"
    festival = shutil.which("text2wave") or "not installed: apt install festival festvox-kallpc16k"
    return {
        "pyserial": str(serial.__version__),
        "serial ports": ", ".join(ports) or "none",
        "eSpeak NG": espeak,
        "Festival": festival,
        "aplay": shutil.which("aplay") or "not installed: speech is written to files",
    }
