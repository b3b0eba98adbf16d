"""Have the kernel end this process when its parent dies."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

__all__ = ["die_with_parent"]

_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def die_with_parent(parent: int) -> bool:
    """Ask the kernel for SIGKILL when the parent ends; False when it has ended already.

    Linux only; elsewhere the host notices that its stdin was closed. The kernel means the
    parent's thread that started this process, so that thread must live on (prctl(2)).
    """
    if sys.platform == "linux":
        ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    return os.getppid() == parent
