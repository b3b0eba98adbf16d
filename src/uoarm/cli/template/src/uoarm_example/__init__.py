"""The uoarm plugin for example. Importing it imports no middleware."""

from __future__ import annotations

from uoarm.bridge import Bridge, BridgeType, hookimpl
from uoarm_example._options import BusOptions, ExampleOptions, mistake

__all__ = ["uoarm_bridge_types"]


def _create(name: str, options: BusOptions) -> Bridge:
    from uoarm_example._bridge import ExampleBridge  # noqa: PLC0415 - imports the middleware

    return ExampleBridge(name, options)


@hookimpl
def uoarm_bridge_types() -> list[BridgeType]:
    """Return the bridge types of this plugin."""
    return [
        BridgeType(
            name="example",
            summary="topics and services of example",
            create=_create,
            bridge_options=BusOptions,
            endpoint_options=ExampleOptions,
            check_endpoint=mistake,
            contract=2,  # of uoarm.bridge, for which this plugin is written
        )
    ]
