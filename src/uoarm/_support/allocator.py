"""What glibc's allocator keeps of the memory that large messages need; others are left alone.

By itself it gives a large block back to the system when it is freed, and each page of the next one
is faulted in anew. That is half of what a picture costs a process.
"""

from __future__ import annotations

import contextlib
import ctypes
import os

__all__ = ["KEEPING", "give_memory_back", "keep_memory"]

_BLOCK, _FREE = 2**25, 2**28
KEEPING = {"MALLOC_MMAP_THRESHOLD_": str(_BLOCK), "MALLOC_TRIM_THRESHOLD_": str(_FREE)}
"""The environment of a process that keeps blocks up to the first size, and as much as the second.

Source: mallopt(3).
"""
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of <malloc.h>


def keep_memory() -> None:
    """Have this process keep as much, for good, unless its environment says something of it."""
    if KEEPING.keys() & os.environ.keys():
        return
    with contextlib.suppress(AttributeError):  # another C library
        set_option = ctypes.CDLL(None).mallopt
        set_option(_MMAP_THRESHOLD, _BLOCK)
        set_option(_TRIM_THRESHOLD, _FREE)


def give_memory_back() -> None:
    """Return free memory to the system, where the C library is one that can."""
    with contextlib.suppress(AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
