"""Measuring one call many times and printing what was found."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

__all__ = ["microseconds", "print_table"]


def microseconds(
    action: Callable[[], object], *, repeat: int = 1000, batch: int = 1
) -> list[float]:
    """Return sorted microseconds of one call each, `batch` calls timed together."""
    samples = []
    for _ in range(repeat):
        start = time.perf_counter_ns()
        for _ in range(batch):
            action()
        samples.append((time.perf_counter_ns() - start) / 1000 / batch)
    return sorted(samples)


def at(samples: Sequence[float], quantile: float) -> float:
    """Return the sample at a quantile of sorted samples."""
    return samples[min(len(samples) - 1, int(len(samples) * quantile))]


def row(name: str, samples: Sequence[float], note: str = "") -> tuple[str, ...]:
    """Return a table row with median and 99th percentile."""
    return name, f"{at(samples, 0.5):,.1f}", f"{at(samples, 0.99):,.1f}", note


def print_table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print one table in Markdown."""
    print(f"\n## {title}\n")
    print("| " + " | ".join(head) + " |")
    print("|" + "---|" * len(head))
    for sequence in rows:
        print("| " + " | ".join(sequence) + " |")
