"""`compression: png`: the text of a message as the pixels of a picture, for browsers to unpack.

The format is that of the PNG specification (ISO/IEC 15948), sections 5 and 11: eight bits for each
of red, green and blue, rows without a filter. Texts are filled up with line ends.
"""

from __future__ import annotations

import math
import struct
import zlib

from pybase64 import b64encode

from uoarm.model import Message
from uoarm_rosbridge._wire import write_publish

__all__ = ["write_publish_png"]

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_EIGHT_BITS, _RGB = 8, 2
_PIXEL = 3
_FASTEST = 1


def write_publish_png(topic: str, message: Message) -> bytes:
    """Return a png message that holds a publish message; raises as `write_publish`."""
    picture = _picture(write_publish(topic, message))
    return b'{"op":"png","data":"' + b64encode(picture) + b'"}'


def _picture(text: bytes) -> bytes:
    pixels = math.ceil(len(text) / _PIXEL)
    width = math.isqrt(pixels)
    height = math.ceil(pixels / width)
    stride = width * _PIXEL
    text = text.ljust(height * stride, b"\n")
    rows = b"".join(b"\0" + text[at : at + stride] for at in range(0, len(text), stride))
    head = struct.pack(">IIBBBBB", width, height, _EIGHT_BITS, _RGB, 0, 0, 0)
    parts = (b"IHDR", head), (b"IDAT", zlib.compress(rows, _FASTEST)), (b"IEND", b"")
    return _SIGNATURE + b"".join(_chunk(kind, data) for kind, data in parts)


def _chunk(kind: bytes, data: bytes) -> bytes:
    check = zlib.crc32(data, zlib.crc32(kind))
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", check)
