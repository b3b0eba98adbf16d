"""uoarm-rtm: OpenRTM components as components of uoarm, over real CORBA.

Importing this package imports no middleware; making a bridge does.
"""

from __future__ import annotations

from uoarm.bridge import Bridge, BridgeType, hookimpl
from uoarm.errors import PluginError
from uoarm_rtm._options import RtmBridgeOptions, RtmEndpointOptions, option_mistake

__all__ = ["uoarm_bridge_types"]

_STUBS = "the stubs of OpenRTM's IDL are missing: install uoarm-rtm again, which makes them"
_OMNIORB = "omniORB cannot be imported: install it with `pip install jeteve-omniorb`"


@hookimpl
def uoarm_bridge_types() -> list[BridgeType]:
    """Return the one bridge type of this plugin."""
    return [
        BridgeType(
            name="rtm",
            summary="OpenRTM components through CORBA",
            create=_create,
            bridge_options=RtmBridgeOptions,
            endpoint_options=RtmEndpointOptions,
            check_endpoint=option_mistake,
            doctor=_doctor,
            contract=2,
        )
    ]


def _create(name: str, options: RtmBridgeOptions) -> Bridge:
    try:
        from uoarm_rtm._bridge import RtmBridge  # noqa: PLC0415 - imports the middleware
    except ImportError as error:
        raise PluginError(f"bridge {name!r}: {_advice(error)} ({error})") from error
    return RtmBridge(name, options)


def _doctor() -> dict[str, str]:
    try:
        from uoarm_rtm._orb import environment  # noqa: PLC0415 - imports the middleware
    except ImportError as error:
        raise PluginError(f"{_advice(error)} ({error})") from error
    return environment()


def _advice(error: ImportError) -> str:
    return _STUBS if error.name == "_uoarm_rtm_stubs" else _OMNIORB
