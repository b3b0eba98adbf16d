"""The lock: what a robot's plans rest on, as a file, and what a difference of it breaks."""

from typing import TYPE_CHECKING

from uoarm._deferred import deferred

if TYPE_CHECKING:
    from uoarm._lock._compare import LockFinding, LockOutcome, compare
    from uoarm._lock._guard import LockGuard, guard_of
    from uoarm._lock._packages import LockedBridge, differing_packages
    from uoarm._lock._record import Lock, LockError, read_lock, record, write_lock
    from uoarm._lock._schemas import read_schemas, uncompared_types

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
            "_compare": ("LockFinding", "LockOutcome", "compare"),
            "_guard": ("LockGuard", "guard_of"),
            "_packages": ("LockedBridge", "differing_packages"),
            "_record": ("Lock", "LockError", "read_lock", "record", "write_lock"),
            "_schemas": ("read_schemas", "uncompared_types"),
        },
    )
