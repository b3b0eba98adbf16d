"""What the allocator keeps of the memory of large messages."""

from __future__ import annotations

import os
import platform
import subprocess
import sys

import pytest

from uoarm._support.process_tuning import KEEPING, give_memory_back

PICTURES = """
import resource, sys
from uoarm._support.process_tuning import keep_memory
keep_memory()
def take():
    return bytes(921_600) + b"-"
for _ in range(20):
    take()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(200):
    take()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def page_faults(**variables: str) -> int:
    """Return how many pages a process faulted in for 200 pictures after its first ones."""
    environment = {name: text for name, text in os.environ.items() if name not in KEEPING}
    command = [sys.executable, "-c", PICTURES]
    ran = subprocess.run(
        command, env=environment | variables, capture_output=True, check=True, timeout=600
    )
    return int(ran.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="it is glibc that is asked")
def test_the_memory_of_large_messages_is_kept_unless_the_environment_says_otherwise() -> None:
    assert page_faults() < 2_000
    assert page_faults(MALLOC_MMAP_THRESHOLD_="131072") > 20_000


def test_free_memory_is_returned_or_left_where_the_system_has_no_such_call() -> None:
    give_memory_back()
