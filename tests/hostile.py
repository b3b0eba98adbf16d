"""Values that no structure expects: a writer writes them or refuses them, and does nothing else."""

from __future__ import annotations

import sys
import threading
from array import array
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, cast

import numpy as np

from uoarm.errors import MessageError

_MUCH = 100_000
_METHODS: Mapping[type, tuple[Any, tuple[str, ...]]] = {
    list: ([1.0, 2.0], ("__iter__", "__len__", "__getitem__")),
    tuple: ((1.0, 2.0), ("__iter__", "__len__")),
    dict: ({"x": 1.0}, ("__iter__", "__len__", "__getitem__", "__contains__", "items", "keys")),
    int: (5, ("__index__", "__int__", "__float__", "__le__", "__lt__", "__repr__", "__str__")),
    float: (1.5, ("__float__", "__eq__", "__floordiv__", "is_integer", "__repr__")),
    str: ("text", ("encode", "isascii", "__contains__", "__len__", "__str__", "__repr__")),
    bytes: (b"abc", ("__len__", "__iter__", "__bytes__")),
    object: (None, ("__index__", "__float__", "__len__", "__iter__", "__repr__", "__class__")),
}
_RAISED = (SystemExit, KeyboardInterrupt, GeneratorExit, RuntimeError)


def _raising(base: type, method: str, kind: type[BaseException]) -> Any:
    def fail(*_: object) -> Any:
        raise kind("hostile")

    value = _METHODS[base][0]
    attribute = property(fail) if method == "__class__" else fail
    made = type("Raising", (base,), {method: attribute})
    return made() if value is None else made(value)


class Endless(list[float]):
    """Gives elements without an end, and notes who takes many of them."""

    takers: list[str] = []  # noqa: RUF012 - of all, in one test at a time

    def __iter__(self) -> Iterator[Any]:
        yield from ((self._element(number)) for number in range(_MUCH))
        self.takers.append(type(self).__name__)

    def _element(self, number: int) -> Any:
        del number
        return 0.0


class EndlessDict(dict[str, Any]):
    """Gives items without an end."""

    def __iter__(self) -> Iterator[str]:
        yield from (f"x{number}" for number in range(_MUCH))
        Endless.takers.append("EndlessDict")

    keys = values = __iter__  # type: ignore[assignment]

    def items(self) -> Any:
        """Give them."""
        return ((key, 1.0) for key in self)


class EndlessMapping(Mapping[str, Any]):
    """As that, and no dict."""

    def __getitem__(self, key: str) -> Any:
        return 1.0

    def __len__(self) -> int:
        return 1

    def __iter__(self) -> Iterator[str]:
        return iter(EndlessDict())


class Claim:
    """Says that it has other elements than it gives."""

    def __init__(self, said: int) -> None:
        self._said = said

    def __len__(self) -> int:
        return self._said

    def __getitem__(self, place: int) -> float:
        if place >= _MUCH:
            Endless.takers.append("Claim")
            raise IndexError
        return 0.0


class ShortList(list[float]):
    """Says that it is shorter than it is."""

    def __len__(self) -> int:
        return 1


class WrongOctets(bytes):
    """Says that it is longer than it is."""

    def __len__(self) -> int:
        return 10


class OddText(str):
    """Writes itself as octets that say that they are more."""

    __slots__ = ()

    def encode(self, encoding: str = "utf-8", errors: str = "strict") -> bytes:
        """Return them."""
        return WrongOctets(super().encode(encoding, errors))


def _deep(levels: int) -> Any:
    value: Any = 1.0
    for _ in range(levels):
        value = [value]
    return value


def _itself() -> Any:
    value: list[Any] = []
    value.append(value)
    return value


def _array_of_itself() -> Any:
    value: Any = np.empty(1, object)
    value[0] = value
    return value


def _released() -> memoryview:
    view = memoryview(b"abc")
    view.release()
    return view


def _zeros(kind: str, shape: Any, part: Any = ...) -> Any:
    return np.zeros(shape, kind)[part]


_TYPES = ("f2", "g", "M8[s]", "m8[s]", "O", "U3", "S3", "V4", "c16", ">f8", ">i4", "?", "u1", "u8")
HOSTILE: Mapping[str, Callable[[], Any]] = {
    **{
        f"{base.__name__}.{method} raises {kind.__name__}": partial(_raising, base, method, kind)
        for base, (_, methods) in _METHODS.items()
        for method in methods
        for kind in _RAISED
    },
    "an endless list": Endless,
    "an endless list that says two": lambda: Endless([1.0, 2.0]),
    "an endless dict": lambda: EndlessDict(x=1.0),
    "an endless mapping": EndlessMapping,
    "an array of an endless list": lambda: np.array([None, Endless([1.0])], object)[1:],
    "more elements than said": lambda: Claim(1),
    "fewer elements than said": lambda: Claim(2**40),
    "a longer list than said": lambda: ShortList([1.0, 2.0]),
    "wrong octets": lambda: WrongOctets(b"abc"),
    "odd text": lambda: OddText("abc"),
    "a deep list": lambda: _deep(50_000),
    "a list of itself": _itself,
    "a whole number of 65 bits": lambda: 2**64,
    "a whole number of 5,000 digits": lambda: 10**4999,
    "no number": lambda: float("nan"),
    "infinity": lambda: float("inf"),
    "half of a pair": lambda: "\ud800",
    "a key that is half of a pair": lambda: {"\ud800": 1},
    "a key that is a number": lambda: {1: 2},
    "a key that is nothing": lambda: {None: 2},
    "a character that ends texts": lambda: "a\0b",
    "every second octet": lambda: memoryview(b"abcdef")[::2],
    "every second number": lambda: memoryview(array("d", [1, 2, 3, 4]))[::2],
    "octets in two dimensions": lambda: memoryview(b"abcdef").cast("B", (2, 3)),
    "characters": lambda: array("w" if sys.version_info >= (3, 13) else "u", "abc"),
    "octets that were released": _released,
    "a set": lambda: {1, 2},
    "a range": lambda: range(3),
    "a deque": lambda: deque([1.0]),
    "a class": lambda: int,
    "an array of itself": _array_of_itself,
    "an array with a mask": lambda: np.ma.masked_array([1.0, 2.0], [False, True]),
    "records of numpy": lambda: np.zeros(2, [("a", "f4"), ("b", "i4")]),
    "no time": lambda: np.datetime64("NaT", "ns"),
    **{f"one {kind}": partial(_zeros, kind, 1, 0) for kind in _TYPES},
    **{f"{kind} without dimensions": partial(_zeros, kind, ()) for kind in _TYPES},
    **{f"every second {kind}": partial(_zeros, kind, 4, slice(None, None, -2)) for kind in _TYPES},
    **{f"{kind} in two dimensions": partial(_zeros, kind, (2, 3)) for kind in _TYPES},
}
LARGE: Mapping[str, Callable[[], Any]] = {
    **{
        f"{kind} that repeats": partial(np.broadcast_to, np.zeros((), kind), (2**31,))
        for kind in ("u1", "f2", "f4", "f8", ">f8", "i8", "?", "U4")
    },
    "octets that repeat": lambda: memoryview(cast("Any", np.broadcast_to(np.uint8(0), (2**31,)))),
    "rows that repeat": lambda: np.broadcast_to(np.uint8(0), (2**16, 2**15)),
}


def misbehaviour(
    write: Callable[[Any], object], refusal: type[Exception] = MessageError
) -> list[str]:
    """Return what a writer does with these values other than to write them, or to refuse them.

    What is too large for any message is refused.

    Args:
        write: takes a value, at the place of a message where it is to stand.
        refusal: what it raises; its text is short.
    """
    reports: list[str] = []

    def run() -> None:  # in a thread in which Ctrl-C is the value's
        for name, make in {**HOSTILE, **LARGE}.items():
            Endless.takers.clear()
            try:
                write(make())
            except refusal as error:
                if len(str(error)) > 2_000:
                    reports.append(f"{name}: its refusal is long")
            except BaseException as error:  # noqa: BLE001 - that is what is looked for
                reports.append(f"{name}: {type(error).__name__}")
            else:
                if name in LARGE:
                    reports.append(f"{name}: it was written")
            if Endless.takers:
                reports.append(f"{name}: all was taken of what has no end")

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    return reports
