"""Components whose messages applications ask for as types of their own."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from uoarm.local import Range


class Header(TypedDict):
    frame: str
    number: int


class RawScan(TypedDict):
    header: Header
    ranges: NDArray[np.float32]


class Limited(TypedDict):
    value: Annotated[int, Range(0, 9)]


def scans() -> Iterator[RawScan]:
    for number in range(3):
        yield {
            "header": {"frame": "laser", "number": number},
            "ranges": np.array([1.0, float("inf")], np.float32),
        }


def nearest(scan: RawScan) -> Limited:
    return {"value": int(min(scan["ranges"]))}
