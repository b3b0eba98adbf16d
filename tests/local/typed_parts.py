"""Components whose messages are objects, and what they are asked to do wrong."""

from __future__ import annotations

import asyncio
import threading
import typing
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from dataclasses import InitVar, dataclass
from enum import Enum
from functools import partial, wraps
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypedDict, TypeVar

import attrs
import numpy as np
from numpy.typing import NDArray
from typing_extensions import ParamSpec

from uoarm.local import Emit, Octets, Range, Shape

if TYPE_CHECKING:
    from decimal import Decimal as Absent

P = ParamSpec("P")
T = TypeVar("T")


class Mode(Enum):
    FAST = "fast"
    SLOW = "slow"


class Point(NamedTuple):
    x: float
    y: float


@attrs.frozen
class Header:
    stamp: int
    mode: Mode
    note: str | None = None


@dataclass
class Scan:
    header: Header
    ranges: NDArray[np.float32]
    points: list[Point]
    picture: Annotated[NDArray[np.uint8], Shape(2, None)]
    raw: Octets
    pair: tuple[int, bool]
    named: dict[str, Point]


class Box(TypedDict):
    scan: Scan
    count: int


class Number(TypedDict):
    value: int


class Reals(TypedDict):
    value: float
    truth: bool


@dataclass
class Count:
    value: int


def scan_of(mode: str = "fast") -> dict[str, Any]:
    return {
        "header": {"stamp": 7, "mode": mode, "note": None},
        "ranges": [0.5, 2.0],
        "points": [{"x": 1.0, "y": 2.0}],
        "picture": [[1, 2, 3], [4, 5, 6]],
        "raw": b"\x01\x02",
        "pair": [3, True],
        "named": {"a": {"x": 0.0, "y": 0.5}},
    }


SCAN = Scan(
    Header(7, Mode.FAST),
    np.array([0.5, 2.0], np.float32),
    [Point(1.0, 2.0)],
    np.array([[1, 2, 3], [4, 5, 6]], np.uint8),
    b"\x01\x02",
    (3, True),
    {"a": Point(0.0, 0.5)},
)


def is_scan(scan: object) -> bool:
    return (
        isinstance(scan, Scan)
        and scan.header == SCAN.header
        and scan.ranges.dtype == np.float32
        and scan.ranges.tolist() == [0.5, 2.0]
        and scan.points == SCAN.points
        and type(scan.points[0]) is Point
        and scan.picture.dtype == np.uint8
        and scan.picture.tolist() == [[1, 2, 3], [4, 5, 6]]
        and bytes(scan.raw) == b"\x01\x02"
        and scan.pair == (3, True)
        and type(scan.named["a"]) is Point
    )


def scans() -> Iterator[Scan]:
    yield SCAN


def pass_scan(scan: Scan) -> Scan:
    assert is_scan(scan), scan
    return scan


def pass_box(box: Box) -> Box:
    assert is_scan(box["scan"]), box
    return box


def ask_scan(scan: Scan) -> Scan:
    return pass_scan(scan)


def ask_scan_unseen(scan: Scan) -> Scan:
    return scan


class Of(TypedDict):
    of: str


def ask_small(asked: Of) -> NDArray[np.int16]:
    numbers = {"2 ** 20": 2**20, "2 ** 10": 2**10, "0.5": 0.5}
    return np.array([numbers[asked["of"]]])


def ask_pixels(asked: Of) -> NDArray[np.uint8]:
    numbers = {"none": [], "list": [0, 255], "wide": np.array([0, 255]), "beyond": np.array([256])}
    return numbers[asked["of"]]  # type: ignore[return-value]


def numpy_numbers() -> Iterator[Number]:
    yield {"value": np.int64(7)}


def numpy_reals() -> Iterator[Reals]:
    yield {"value": np.float32(0.5), "truth": np.bool_(True)}  # type: ignore[typeddict-item]


def numpy_count() -> Iterator[Count]:
    yield Count(np.int64(7))


def wrong_number(asked: Number) -> Number:
    return {"value": "nine"}  # type: ignore[typeddict-item]


def wrong_reply(asked: Number) -> Count:
    return Count("nine")  # type: ignore[arg-type]


def vague(picture: np.ndarray) -> Number:
    return {"value": picture.ndim}


def very_vague(picture: NDArray[Any]) -> Number:
    return {"value": picture.ndim}


class Named:
    """It has named inputs and named outputs, and nothing else."""

    def __init__(self, factor: Annotated[int, Range(1)] = 1) -> None:
        self._factor = factor

    def left(self, message: Number) -> Emit:
        return Emit("sum", {"value": message["value"] * self._factor})

    def right(self, message: Number) -> Iterator[Emit]:
        yield Emit("sum", {"value": -message["value"] * self._factor})


class Limits(NamedTuple):
    least: float
    most: float


def clip(message: Reals, limits: Limits, *, near: float = 0.5) -> Reals:
    value = min(max(message["value"], limits.least), limits.most)
    return {"value": value, "truth": message["truth"]}


class Started:
    """How far asynchronous components got."""

    cancelled = threading.Event()
    begun = threading.Event()
    threads: set[str] = set()  # noqa: RUF012 - of all of them
    left: asyncio.Task[None]


async def wait_long(message: Number) -> Number:
    Started.begun.set()
    try:
        await asyncio.Event().wait()
    except asyncio.CancelledError:
        Started.cancelled.set()
        raise
    return message


async def add(message: Number) -> Number:
    Started.threads.add(threading.current_thread().name)
    await asyncio.sleep(0)
    return {"value": message["value"] + 1}


async def stop_the_loop(message: Number) -> Number:
    asyncio.get_running_loop().stop()
    await asyncio.sleep(0)
    return message


async def leave_behind(message: Number) -> Number:
    """Leave a task that raises what ends a thread as the loop ends."""

    async def quit_late() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            raise KeyboardInterrupt

    Started.left = asyncio.create_task(quit_late())
    await asyncio.sleep(0)
    return message


async def count_up(message: Number) -> AsyncIterator[Number]:
    for value in range(message["value"]):
        await asyncio.sleep(0)
        yield {"value": value}


def decorated(function: Callable[P, T]) -> Callable[P, T]:
    """Hide from a function what it is, as most decorators do."""

    @wraps(function)
    def called(*args: P.args, **kwargs: P.kwargs) -> T:
        return function(*args, **kwargs)

    return called


add_decorated = decorated(add)
count_up_decorated = decorated(count_up)


async def counting() -> AsyncIterator[Count]:
    for value in range(3):
        await asyncio.sleep(0)
        yield Count(value)


async def silent_source() -> AsyncIterator[Number]:
    Started.begun.set()
    try:
        await asyncio.Event().wait()
    except asyncio.CancelledError:
        Started.cancelled.set()
        raise
    yield {"value": 0}


class Adder:
    """Asynchronous in everything, with a state in one thread."""

    def __init__(self, start: int = 0) -> None:
        self._value = start

    async def __call__(self, message: Number) -> Number:
        await asyncio.sleep(0)
        self._value += message["value"]
        return {"value": self._value}

    async def close(self) -> None:
        await asyncio.sleep(0)
        Started.cancelled.set()


def _scaled(scale: float, twin: Twin) -> Twin:
    assert type(twin) is Twin
    return Twin(int(scale * twin.value))


def _numbered(last: int) -> Iterator[Twin]:
    yield from map(Twin, range(last))


def iterable_counts() -> Iterable[int]:
    yield from range(2)


def bare_counts() -> typing.Iterator:  # type: ignore[type-arg]
    yield from range(2)


@dataclass
class Twin:
    value: int


doubled_twin = partial(_scaled, 2.0)
tripled_twin = partial(partial(_scaled), 3.0)
two_twins = partial(_numbered, last=2)


@dataclass
class Seeded:
    value: int
    seed: InitVar[int]


class Shifted(TypedDict):
    inner: list[Count | Twin | None]


def either(message: Count | Twin) -> Number:
    return {"value": message.value}


def perhaps(message: Shifted) -> Number:
    return {"value": len(message["inner"])}


def seeded(message: Seeded) -> Number:
    return {"value": message.value}


def seed_within(message: Number, seeds: list[Seeded]) -> Number:
    return {"value": message["value"] + len(seeds)}


@dataclass
class Holder:
    value: Absent


def takes_absent(message: Holder) -> Number:
    return {"value": int(message.value)}


def absent(message: Absent) -> Number:
    return {"value": int(message)}


def given_absent(message: Number, more: Holder) -> Number:
    return {"value": message["value"] + int(more.value)}


def gives_either() -> Iterator[Count | Twin]:
    yield Count(1)
    yield Twin(2)
