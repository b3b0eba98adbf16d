"""uoarm-mqtt: topics and services on an MQTT 5 broker as components of uoarm."""

from __future__ import annotations

from uoarm.bridge import Bridge, BridgeType, Description, hookimpl
from uoarm.model import Endpoint, Options
from uoarm_mqtt._options import BrokerOptions, MqttOptions, TopicOptions, mistake

__all__ = ["BrokerOptions", "uoarm_bridge_types"]


def _create(name: str, options: MqttOptions) -> Bridge:
    from uoarm_mqtt._bridge import MqttBridge  # noqa: PLC0415 - imports paho

    return MqttBridge(name, options)


def _describe(endpoint: Endpoint, options: MqttOptions) -> Description:
    from uoarm_mqtt._discovery import describe_offline  # noqa: PLC0415 - imports paho

    return describe_offline(endpoint, options)


def _topic(address: tuple[str, ...], options: Options) -> str:
    del options
    return address[0] if len(address) == 1 else ""


def _doctor() -> dict[str, str]:
    from importlib.metadata import version  # noqa: PLC0415 - not needed to load the plugin

    return {"paho-mqtt": f"{version('paho-mqtt')} (EPL-2.0 or EDL-1.0)"}


@hookimpl
def uoarm_bridge_types() -> list[BridgeType]:
    """Return the one bridge type of this plugin."""
    return [
        BridgeType(
            name="mqtt",
            summary="topics and services on an MQTT 5 broker",
            create=_create,
            bridge_options=MqttOptions,
            endpoint_options=TopicOptions,
            check_endpoint=mistake,
            topic=_topic,
            doctor=_doctor,
            describe=_describe,
            contract=2,
        )
    ]
