"""uoarm-remote: the functions of another uoarm manager as components of uoarm."""

from __future__ import annotations

from uoarm.bridge import Bridge, BridgeType, hookimpl
from uoarm_remote._options import FunctionOptions, ManagerOptions, mistake

__all__ = ["uoarm_bridge_types"]


def _create(name: str, options: ManagerOptions) -> Bridge:
    from uoarm_remote._bridge import RemoteManagerBridge  # noqa: PLC0415 - imports websockets

    return RemoteManagerBridge(name, options)


@hookimpl
def uoarm_bridge_types() -> list[BridgeType]:
    """Return the one bridge type of this plugin."""
    return [
        BridgeType(
            name="remote",
            summary="functions of another uoarm manager, over its server",
            create=_create,
            bridge_options=ManagerOptions,
            endpoint_options=FunctionOptions,
            check_endpoint=mistake,
            contract=2,
        )
    ]
