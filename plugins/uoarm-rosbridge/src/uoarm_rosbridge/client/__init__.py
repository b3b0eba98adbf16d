"""The bridge `rosbridge`: what stands behind any rosbridge server, of ROS 1 or 2, as components."""

from __future__ import annotations

from uoarm.bridge import Bridge, BridgeType, hookimpl
from uoarm_rosbridge.client._options import ClientOptions, Port, mistake, topic_name

__all__ = ["uoarm_bridge_types"]


@hookimpl
def uoarm_bridge_types() -> list[BridgeType]:
    """Return the one bridge type of this plugin."""
    return [
        BridgeType(
            name="rosbridge",
            summary="topics, services, actions and parameters behind a rosbridge server",
            create=_create,
            bridge_options=ClientOptions,
            endpoint_options=Port,
            check_endpoint=mistake,
            topic=topic_name,
            contract=2,
        )
    ]


def _create(name: str, options: ClientOptions) -> Bridge:
    from uoarm_rosbridge.client._bridge import RosbridgeBridge  # noqa: PLC0415 - the server's, too

    return RosbridgeBridge(name, options)
