"""A disk that is full: no file grows beyond so many octets while this is open."""

from __future__ import annotations

import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def full_after(octets: int) -> Iterator[None]:
    """Have the kernel refuse what this process, and what it starts, writes beyond a size (EFBIG).

    Python ignores the signal that comes with it, so that writing fails as on a full disk. Of a
    module that is imported meanwhile it would keep the first octets of its bytecode, and every
    later process would fail to import it: so no bytecode is written.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "dont_write_bytecode", True)
        patch.setenv("PYTHONDONTWRITEBYTECODE", "1")
        resource.setrlimit(resource.RLIMIT_FSIZE, (octets, hard))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
