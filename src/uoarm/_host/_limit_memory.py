"""Have the kernel refuse memory beyond a limit to this process."""

from __future__ import annotations

import resource
import sys

__all__ = ["limit_memory"]


def limit_memory(octets: int | None) -> None:
    """Limit what this process may write to: its heap, its threads' stacks, its private pages.

    What it asks for beyond fails: Python raises MemoryError, native code may abort. Addresses
    that are only reserved, libraries and shared memory do not count, since RLIMIT_DATA and not
    RLIMIT_AS is set (getrlimit(2)): a host of Zenoh reserves ten times what it uses. Linux only.
    """
    if octets is not None and sys.platform == "linux":
        resource.setrlimit(resource.RLIMIT_DATA, (octets, octets))
