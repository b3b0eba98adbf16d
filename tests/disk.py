"""A disk that is full: no file grows beyond so many octets while this is open."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["full_after"]


@contextmanager
def full_after(octets: int) -> Iterator[None]:
    """Have the kernel refuse what this process, and what it starts, writes beyond a size (EFBIG).

    Python ignores the signal that comes with it, so that writing fails as on a full disk.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (octets, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
