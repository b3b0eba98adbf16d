"""Measuring one call many times and printing what was found."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence


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


def spread(samples: Iterable[float], digits: int = 0) -> str:
    """Return median and 99th percentile in one cell."""
    ordered = sorted(samples)
    return f"{at(ordered, 0.5):,.{digits}f} / {at(ordered, 0.99):,.{digits}f}"


def row(name: str, samples: Iterable[float], note: str = "", digits: int = 1) -> tuple[str, ...]:
    """Return a table row with median and 99th percentile."""
    return name, *spread(samples, digits).split(" / "), note


def print_table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print one table in Markdown."""
    print(f"\n## {title}\n")
    print("| " + " | ".join(head) + " |")
    print("|" + "---|" * len(head))
    for cells in rows:
        print("| " + " | ".join(cells) + " |")
