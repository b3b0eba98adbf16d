"""Settings of the Zenoh session that a link is made of."""

from __future__ import annotations

import json
from collections.abc import Mapping
from types import MappingProxyType

import zenoh

__all__ = ["NO_MORE", "configuration"]

NO_MORE: Mapping[str, object] = MappingProxyType({})
_FULL_MICROSECONDS = 200_000
_RETRY_MILLISECONDS = 200


def configuration(
    place: str,
    *,
    listen: bool,
    timeout: float,
    lease: float,
    shared_memory: bool,
    more: Mapping[str, object] = NO_MORE,
) -> zenoh.Config:
    """Return settings under which nothing is found by itself and nothing listens elsewhere."""
    settings: dict[str, object] = {
        "mode": "router" if listen else "client",
        "listen/endpoints": [place] if listen else [],
        "connect/endpoints": [] if listen else [place],
        "connect/timeout_ms": int(timeout * 1000),
        "connect/retry": {
            "period_init_ms": _RETRY_MILLISECONDS,
            "period_max_ms": _RETRY_MILLISECONDS,
        },
        "scouting/delay": 0,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": shared_memory,
        "transport/unicast/open_timeout": int(timeout * 1000),
        "transport/link/tx/lease": int(lease * 1000),
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": _FULL_MICROSECONDS,
        "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": (
            _FULL_MICROSECONDS
        ),
        **more,
    }
    configuration: zenoh.Config = zenoh.Config()
    for name, value in settings.items():
        configuration.insert_json5(name, json.dumps(value))
    return configuration
