"""The uoarm plugin for example. Importing it imports no middleware."""

from __future__ import annotations

from uoarm.bridge import Bridge, BridgeType, hookimpl
from uoarm.model import Options

__all__ = ["uoarm_bridge_types"]


def _create(name: str, options: Options) -> Bridge:
    from uoarm_example._bridge import ExampleBridge  # noqa: PLC0415 - imports the middleware

    return ExampleBridge(name, options)


def _check_endpoint(address: tuple[str, ...], options: Options) -> str:
    del options
    return "" if len(address) == 1 else f"expected one topic, got {list(address)}"


@hookimpl
def uoarm_bridge_types() -> list[BridgeType]:
    """Return the bridge types of this plugin."""
    return [
        BridgeType(
            name="example",
            summary="example, by way of a bus in this process",
            create=_create,
            options_schema={"type": "object", "properties": {}, "additionalProperties": False},
            check_endpoint=_check_endpoint,
            contract=2,  # of uoarm.bridge, for which this plugin is written
        )
    ]
