"""The lock: what a robot's plans rest on, as a file, and what a difference of it breaks."""

from typing import TYPE_CHECKING

from uoarm._deferred import deferred

if TYPE_CHECKING:
    from uoarm._lock._compare import (
        LockFinding,
        LockGuard,
        LockOutcome,
        compare,
        guard_of,
        read_schemas,
        uncompared_types,
    )
    from uoarm._lock._record import (
        Lock,
        LockedBridge,
        LockError,
        differing_packages,
        read_lock,
        record,
        write_lock,
    )

__all__ = [
    "Lock",
    "LockError",
    "LockFinding",
    "LockGuard",
    "LockOutcome",
    "LockedBridge",
    "compare",
    "differing_packages",
    "guard_of",
    "read_lock",
    "read_schemas",
    "record",
    "uncompared_types",
    "write_lock",
]

if not TYPE_CHECKING:
    __getattr__, __dir__ = deferred(
        __name__,
        {
            "_compare": (
                "LockFinding",
                "LockGuard",
                "LockOutcome",
                "compare",
                "guard_of",
                "read_schemas",
                "uncompared_types",
            ),
            "_record": (
                "Lock",
                "LockError",
                "LockedBridge",
                "differing_packages",
                "read_lock",
                "record",
                "write_lock",
            ),
        },
    )
