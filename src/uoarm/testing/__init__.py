"""Help for testing bridges, components and applications: a bridge to play on, faults, waiting.

The conformance kit for bridge authors is `uoarm.testing.conformance`, which needs pytest;
`instances` needs hypothesis. Nothing else here needs more than uoarm itself.
"""

from uoarm.testing._components import Emitter, Loop, MemoryService, Script, Taker
from uoarm.testing._faults import Hang, Proxy, hanging, lying, raising
from uoarm.testing._instances import find_instance, instances
from uoarm.testing._memory import MemoryBridge
from uoarm.testing._resources import ResourceSnapshot, free_port, hold_idle
from uoarm.testing._waiting import (
    Background,
    Collector,
    ManualClock,
    copies,
    losses,
    patience,
    plain,
    same,
    slowness,
    wait,
)

__all__ = [
    "Background",
    "Collector",
    "Emitter",
    "Hang",
    "Loop",
    "ManualClock",
    "MemoryBridge",
    "MemoryService",
    "Proxy",
    "ResourceSnapshot",
    "Script",
    "Taker",
    "copies",
    "find_instance",
    "free_port",
    "hanging",
    "hold_idle",
    "instances",
    "losses",
    "lying",
    "patience",
    "plain",
    "raising",
    "same",
    "slowness",
    "wait",
]
