"""Hostile inputs by name, for tests that attack a running server.

`HOSTILE` has what one client sends, and `attack_beside` lets another be served meanwhile. The
function `anything` of `tests.server.robot` takes values of any structure.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Literal, TypeAlias

from attrs import frozen

from uoarm.server import Server

Form: TypeAlias = Literal["json", "cbor"]
Frame: TypeAlias = "str | bytes"

LARGEST = 16_777_216 - 1024
"""Octets of the longest frame, which a server takes with its settings as they come."""
_GLANCE_SECONDS = 0.002


@frozen
class Hostile:
    """What to send.

    Attributes:
        form: which protocol the client speaks.
        frames: makes the frames, in order; they are large, so made when they are needed.
        errors: how many errors come back; the session goes on afterwards.
    """

    form: Form
    frames: Callable[[], Iterator[Frame]]
    errors: int = 1


def head(major: int, count: int) -> bytes:
    """Return the head of a CBOR item (RFC 8949, section 3)."""
    if count < 24:
        return bytes([major << 5 | count])
    for more, size in ((24, 1), (25, 2), (26, 4)):
        if count < 1 << 8 * size:
            return bytes([major << 5 | more]) + count.to_bytes(size, "big")
    return bytes([major << 5 | 27]) + count.to_bytes(8, "big")


def text(value: str) -> bytes:
    return head(3, len(value)) + value.encode()


def rows(sizes: list[int], items: bytes) -> bytes:
    """Return a multi-dimensional array (RFC 8746, section 3.1.1), true or not."""
    return b"\xd8\x28\x82" + head(4, len(sizes)) + b"".join(head(0, size) for size in sizes) + items


def cbor_fields(**fields: bytes) -> bytes:
    return head(5, len(fields)) + b"".join(text(name) + field for name, field in fields.items())


def cbor_call(value: bytes) -> bytes:
    return cbor_fields(op=text("Call"), type=text("anything"), id=text("h"), jsonMessage=value)


def cbor_data(value: bytes) -> bytes:
    return cbor_fields(op=text("Data"), type=text("c1"), id=text("h"), jsonMessage=value)


def json_call(value: str) -> str:
    return f'{{"op":"Call","type":"anything","id":"h","jsonMessage":{value}}}'


def resume(waiting: str) -> str:
    return f'{{"op":"Resume","id":"h","jsonMessage":{{"key":"k","waiting":{waiting}}}}}'


def many(item: str, octets: int = LARGEST) -> str:
    """Return a list as JSON text that is filled with one item."""
    return f"[{','.join([item] * (octets // (len(item) + 1)))}]"


def many_cbor(item: bytes, octets: int = LARGEST) -> bytes:
    count = octets // len(item)
    return head(4, count) + item * count


def rows_in_rows(times: int, sizes: list[int]) -> bytes:
    """Return arrays of several dimensions within one another: each adds to the depth."""
    value = rows(sizes, b"\x81\x01")
    for _ in range(times):
        value = rows(sizes, b"\x81" + value)
    return value


def _one(form: Form, frame: Callable[[], Frame]) -> Hostile:
    return Hostile(form, lambda: iter([frame()]))


_BIG = 2**63 - 1
_ONE = b"\x81\x01"

HOSTILE: Mapping[str, Hostile] = {
    # Arrays of many dimensions (CBOR tag 40): depth and numbers that were never written.
    "60,000 dimensions": _one("cbor", lambda: cbor_call(rows([1] * 60_000, _ONE))),
    "5,000 dimensions": _one("cbor", lambda: cbor_call(rows([1] * 5_000, _ONE))),
    "dimensions within dimensions": _one("cbor", lambda: cbor_call(rows_in_rows(30, [1] * 8))),
    "huge dimensions": _one("cbor", lambda: cbor_data(rows([_BIG] * 64_000, _ONE))),
    "rows of one": _one(
        "cbor",
        lambda: cbor_call(
            rows([LARGEST - 200, 1], b"\xd8\x40" + head(2, LARGEST - 200) + bytes(LARGEST - 200))
        ),
    ),
    "dimensions as the id": _one(
        "cbor",
        lambda: cbor_fields(op=text("List"), id=rows([1] * 5_000, _ONE)),
    ),
    "dimensions in options": _one(
        "cbor",
        lambda: cbor_fields(
            op=text("Request"),
            type=text("numbers"),
            id=text("h"),
            jsonMessage=rows([1] * 5_000, _ONE),
        ),
    ),
    # Many small values in one frame.
    "empty lists": _one("json", lambda: json_call(many("[]"))),
    "small objects": _one("json", lambda: json_call(many('{"a":[]}'))),
    "empty texts": _one("json", lambda: json_call(many('""'))),
    "numbers": _one("json", lambda: json_call(many("1"))),
    "names": _one(
        "json",
        lambda: json_call("{" + ",".join(f'"{index}":1' for index in range(1_200_000)) + "}"),
    ),
    "empty lists in CBOR": _one("cbor", lambda: cbor_call(many_cbor(b"\x80"))),
    "empty maps in CBOR": _one("cbor", lambda: cbor_call(many_cbor(b"\xa0"))),
    "short texts in CBOR": _one("cbor", lambda: cbor_call(many_cbor(b"\x61a"))),
    "small big numbers": _one("cbor", lambda: cbor_call(many_cbor(b"\xc2\x41\x01"))),
    "small typed arrays": _one("cbor", lambda: cbor_call(many_cbor(b"\xd8\x40\x41a"))),
    "half floats": _one(
        "cbor", lambda: cbor_call(b"\xd8\x54" + head(2, LARGEST - 200) + bytes(LARGEST - 200))
    ),
    "lists that claim to be long": _one("cbor", lambda: cbor_call(b"\x9a\x00\xff\xff\xff" * 60)),
    # Values where a short text is expected: they must not be written out in the error.
    "a list as the op": _one("json", lambda: f'{{"op":{many("1")},"id":"h"}}'),
    "a list as the type": _one(
        "json", lambda: f'{{"op":"Kill","type":{many("1", 900_000)},"id":"h"}}'
    ),
    "many ids to wait for": _one("json", lambda: resume(many('"i"', 1_900_000))),
    "many extensions": _one(
        "json",
        lambda: (
            '{"op":"List","id":"h",' + ",".join(f'"x-{index}":1' for index in range(240_000)) + "}"
        ),
    ),
}


def resident() -> int:
    """Return the bytes of memory that this process has."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def attack_beside(server: Server, attack: Callable[[Server], None], ask: Callable[[], None]) -> int:
    """Attack a server while another client asks it, and return the most octets that it held."""
    failures: list[BaseException] = []

    def run() -> None:
        try:
            attack(server)
        except BaseException as error:  # noqa: BLE001 - shown by the test
            failures.append(error)

    attacking = threading.Thread(target=run, daemon=True)
    attacking.start()
    held, goes_on = 0, True
    while goes_on:  # once at least, also where the attack is over before we come to run
        attacking.join(_GLANCE_SECONDS)  # without a pause it takes what the attack needs
        goes_on = attacking.is_alive()
        ask()
        held = max(held, server.held_octets)
    assert not failures
    return held
