"""uoarm-vda5050: vehicles that speak VDA 5050 as components of uoarm."""

from __future__ import annotations

from uoarm.bridge import Bridge, BridgeType, hookimpl
from uoarm.model import Options
from uoarm_vda5050._options import FleetOptions, VehicleOptions, mistake
from uoarm_vda5050._releases import SENT

__all__ = ["uoarm_bridge_types"]


def _create(name: str, options: FleetOptions) -> Bridge:
    from uoarm_vda5050._bridge import Vda5050Bridge  # noqa: PLC0415 - imports paho

    return Vda5050Bridge(name, options)


def _topic(address: tuple[str, ...], options: Options) -> str:
    del options
    return "/".join(address) if address and address[-1] in SENT else ""


def _doctor() -> dict[str, str]:
    from importlib.metadata import version  # noqa: PLC0415 - not needed to load the plugin

    return {"uoarm-mqtt": version("uoarm-mqtt"), "paho-mqtt": version("paho-mqtt")}


@hookimpl
def uoarm_bridge_types() -> list[BridgeType]:
    """Return the one bridge type of this plugin."""
    return [
        BridgeType(
            name="vda5050",
            summary="vehicles that speak VDA 5050, through an MQTT 5 broker",
            create=_create,
            bridge_options=FleetOptions,
            endpoint_options=VehicleOptions,
            check_endpoint=mistake,
            topic=_topic,
            doctor=_doctor,
            contract=2,
        )
    ]
