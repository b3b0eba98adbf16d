"""What the soak watches of its own process: memory, threads, descriptors; and how it draws them."""

from __future__ import annotations

import gc
import itertools
import os
import threading
from collections.abc import Sequence
from pathlib import Path

from attrs import frozen

__all__ = ["Sample", "look", "sparkline"]

_BARS = "▁▂▃▄▅▆▇█"


@frozen
class Sample:
    """This process at one moment."""

    memory_megabytes: float
    threads: int
    descriptors: int


def look() -> Sample:
    """Return what this process holds now, after a collection."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return Sample(
        memory_megabytes=pages * os.sysconf("SC_PAGE_SIZE") / 1e6,
        threads=threading.active_count(),
        descriptors=sum(1 for _ in Path("/proc/self/fd").iterdir()),
    )


def sparkline(values: Sequence[float], width: int = 60) -> str:
    """Draw a row of values as bars, the lowest as the lowest bar; each bar is a mean."""
    if not values:
        return ""
    width = min(width, len(values))
    edges = [round(n * len(values) / width) for n in range(width + 1)]
    means = [sum(values[low:high]) / (high - low) for low, high in itertools.pairwise(edges)]
    low, span = min(means), (max(means) - min(means)) or 1.0
    return "".join(_BARS[int((mean - low) / span * (len(_BARS) - 1))] for mean in means)
