"""What a msgpack tree claims to hold, compared with what there is, before lists are made for it."""

from __future__ import annotations

import re

from uoarm.errors import MessageError

__all__ = ["check_claims"]

# Below this, the longest claims nested as deep as the decoder goes take some ten megabytes.
_SMALL = 4096
_HARMLESS = 1_000_000
# Runs of items that hold no others, or 15 at most, and no texts: by what follows their heads.
_RUN = re.compile(
    rb"[\x00-\xa0\xc0\xc2\xc3]{1,4096}"
    rb"|(?:[\xcc\xd0].){1,4096}"
    rb"|(?:[\xcd\xd1]..){1,4096}"
    rb"|(?:[\xca\xce\xd2].{4}){1,4096}"
    rb"|(?:[\xcb\xcf\xd3].{8}){1,4096}",
    re.DOTALL,
)
_SHORT_TEXT, _FIXED_EXTENSION = 0xA0, 0xD4
# Octets of the length, by head: binary, extensions (with their type behind it), texts.
_SIZED = {0xC4: 1, 0xC5: 2, 0xC6: 4, 0xC7: 1, 0xC8: 2, 0xC9: 4, 0xD9: 1, 0xDA: 2, 0xDB: 4}
_EXTENSIONS = {0xC7, 0xC8, 0xC9}
_CONTAINERS = {0xDC: 2, 0xDD: 4, 0xDE: 2, 0xDF: 4}
_MAPS = {0xDE, 0xDF}


def check_claims(frame: bytes, start: int, end: int) -> None:
    """Refuse a tree whose lists and maps claim more items than it has octets.

    The decoder makes a list as long as it claims to be before it reads the first item, so nested
    claims that nothing stands behind would cost a thousand times the frame. A few passes in C tell
    for most trees that their claims cannot matter; only the others are walked over, head by head.

    Raises:
        MessageError: it claims too much.
    """
    size = end - start
    if size <= _SMALL:
        return
    worst = sum(
        frame.count(head, start, end) * min(1 << 8 * width, size)
        for head, width in _CONTAINERS.items()
    )
    if worst <= _HARMLESS:
        return
    claimed, place = 0, start
    while place < end:
        run = _RUN.match(frame, place, end)
        if run is not None:
            place = run.end()
            continue
        head = frame[place]
        place += 1
        if head in _CONTAINERS:
            width = _CONTAINERS[head]
            count = int.from_bytes(frame[place : place + width], "big")
            place += width
            claimed += 2 * count if head in _MAPS else count
            if claimed > size:
                raise MessageError(f"a frame of {size:,} octets claims to hold {claimed:,} values")
        elif head in _SIZED:
            width = _SIZED[head]
            place += width + int.from_bytes(frame[place : place + width], "big")
            place += head in _EXTENSIONS
        elif head >= _FIXED_EXTENSION:
            place += (1 << (head - _FIXED_EXTENSION)) + 1
        else:
            place += head - _SHORT_TEXT
