"""How many items CBOR has, found from their heads before a decoder is let loose on them."""

from __future__ import annotations

import re

from uoarm.model import Spending

__all__ = ["scan_cbor"]

# Runs of items without anything behind their heads but an argument of one size, by group: no
# argument, 1, 2, 4 and 8 octets. Long lists of numbers are counted at the speed of C.
_RUNS = re.compile(
    rb"([\x00-\x17\x20-\x37\x40\x60\x80-\x97\xa0-\xb7\xc0-\xd7\xe0-\xf7]{1,4096})"
    rb"|((?:[\x18\x38\x98\xb8\xd8\xf8].){1,4096})"
    rb"|((?:[\x19\x39\x99\xb9\xd9\xf9]..){1,4096})"
    rb"|((?:[\x1a\x3a\x9a\xba\xda\xfa].{4}){1,4096})"
    rb"|((?:[\x1b\x3b\x9b\xbb\xdb\xfb].{8}){1,4096})",
    re.DOTALL,
)
_WIDTHS = (0, 1, 2, 3, 5, 9)
_OCTETS, _TEXT = 2, 3
_SMALL, _LARGEST = 24, 27


def scan_cbor(data: bytes, spending: Spending) -> None:
    """Refuse data with more items than its budget allows; the heads of tags count as items.

    Walks over the heads, jumps over texts and octets, and stops with the last item that is allowed.
    What is no CBOR is left to the decoder, whose first mistake is where this loses its way.

    Raises:
        ControlMessageError: it holds too much.
    """
    place, end = 0, len(data)
    items, most = 0, spending.budget.elements - spending.elements
    while place < end and items <= most:
        run = _RUNS.match(data, place)
        if run is not None:
            assert run.lastindex is not None, "each branch is a group"
            items += (run.end() - place) // _WIDTHS[run.lastindex]
            place = run.end()
            continue
        items += 1
        major, more = data[place] >> 5, data[place] & 31
        place += 1
        if more > _LARGEST:  # begins or ends an item of unknown length
            continue
        length = more
        if more >= _SMALL:
            size = 1 << (more - _SMALL)
            length = int.from_bytes(data[place : place + size], "big")
            place += size
        if major in {_OCTETS, _TEXT}:
            place += length
    spending.add(items)
