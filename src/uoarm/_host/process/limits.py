"""What the kernel enforces on a host process: it ends with its parent, and within its memory."""

from __future__ import annotations

import ctypes
import os
import resource
import signal
import sys

__all__ = ["die_with_parent", "limit_memory", "outlive_parent"]

_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def die_with_parent(parent: int) -> bool:
    """Ask the kernel for SIGKILL when the parent ends; False when it has ended already.

    Linux only; elsewhere the host notices that its stdin was closed. The kernel means the
    parent's thread that started this process, so that thread must live on (prctl(2)).
    """
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    return os.getppid() == parent


def outlive_parent() -> None:
    """Have the kernel do nothing when the parent ends; of the thread that asked for the opposite.

    For a host that has something to stop first. It then ends by itself, unless it hangs.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, 0, 0, 0, 0)


def limit_memory(octets: int | None) -> None:
    """Limit what this process may write to: its heap, its threads' stacks, its private pages.

    What it asks for beyond fails: Python raises MemoryError, native code may abort. Addresses
    that are only reserved, libraries and shared memory do not count, since RLIMIT_DATA and not
    RLIMIT_AS is set (getrlimit(2)): middleware such as Zenoh reserves ten times what it uses.
    Linux only.
    """
    if octets is not None and sys.platform == "linux":
        resource.setrlimit(resource.RLIMIT_DATA, (octets, octets))
