"""Camera: pictures from a video, a picture, a folder of both, or a device."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np

from uoarm_vision.messages import Frame
from uoarm_vision.pixels import Picture, as_frame

__all__ = ["camera", "count"]

_PICTURES = frozenset({".bmp", ".jpeg", ".jpg", ".png"})
_VIDEOS = frozenset({".avi", ".mkv", ".mov", ".mp4", ".webm"})


def camera(
    path: str | int,
    rate: float = 0.0,
    limit: int = 0,
    excerpt: int = 0,
    loop: bool = False,  # noqa: FBT001, FBT002 - a parameter of the configuration file
) -> Iterator[Frame]:
    """Yield pictures, as fast as they are taken unless `rate` says otherwise.

    Args:
        path: a file, a folder that is played in the order of its names, or a device's number;
            `~` and `$NAME` are replaced.
        rate: pictures a second at most; 0 for no limit. Devices keep their own.
        limit: pictures altogether; 0 for all.
        excerpt: pictures of each video; 0 for all.
        loop: begin again at the end.

    Raises:
        FileNotFoundError: there is nothing to play at `path`.
        OSError: a file or device cannot be read as pictures, or a device gives no more.
    """
    if _is_device(path):
        rate = 0.0
    playing = _again(path, excerpt) if loop else _play(path, excerpt)
    due = time.monotonic()
    for sequence, (source, picture) in enumerate(itertools.islice(playing, limit or None)):
        if rate:
            time.sleep(max(0.0, due - time.monotonic()))
            due = time.monotonic() + 1 / rate
        yield as_frame(picture, source, sequence)


def count(path: str, excerpt: int = 0) -> int:
    """Return how many pictures `camera` takes from a file or folder when it plays it once."""
    return sum(1 if _is_picture(file) else _length(file, excerpt) for file in _files(path))


def _again(path: str | int, excerpt: int) -> Iterator[tuple[str, Picture]]:
    while True:
        yield from _play(path, excerpt)


def _play(path: str | int, excerpt: int) -> Iterator[tuple[str, Picture]]:
    if _is_device(path):
        yield from _frames(int(path), f"device {path}", 0)
        # A recording ends in order; a camera that ends is unplugged, and another one takes over.
        raise OSError(f"device {path} gives no more pictures")
    for file in _files(str(path)):
        if _is_picture(file):
            yield file.name, _photo(file)
        else:
            yield from _frames(str(file), file.name, excerpt)


def _is_device(path: str | int) -> bool:
    return str(path).isdecimal()


def _files(path: str) -> list[Path]:
    whole = Path(os.path.expandvars(path)).expanduser()
    if not whole.exists():
        unset = " ($NAME stands where no such variable is set)" if "$" in str(whole) else ""
        raise FileNotFoundError(f"the camera's path {str(whole)!r} does not exist{unset}")
    if whole.is_file():
        return [whole]
    files = sorted(file for file in whole.iterdir() if file.suffix.lower() in _PICTURES | _VIDEOS)
    if not files:
        raise FileNotFoundError(f"the folder {str(whole)!r} has no pictures or videos")
    return files


def _is_picture(file: Path) -> bool:
    return file.suffix.lower() in _PICTURES


def _photo(file: Path) -> Picture:
    picture = cv2.imread(str(file), cv2.IMREAD_COLOR)
    if picture is None:
        raise OSError(f"{file} cannot be read as a picture")
    return picture.astype(np.uint8, copy=False)


def _frames(what: str | int, source: str, excerpt: int) -> Iterator[tuple[str, Picture]]:
    with closing(_Video(what, source)) as video:
        pictures = itertools.islice(video, excerpt or None)
        first = next(pictures, None)
        if first is None:
            raise OSError(f"{source} has no pictures that can be read")
        for picture in itertools.chain([first], pictures):
            yield source, picture


def _length(file: Path, excerpt: int) -> int:
    """Count by decoding: what a container says of its length need not be true."""
    return sum(1 for _ in _frames(str(file), file.name, excerpt))


class _Video:
    """An open video or device, to iterate over once and to close."""

    def __init__(self, what: str | int, source: str) -> None:
        self._capture = cv2.VideoCapture()
        opened = self._capture.open(what)
        if not opened:
            raise OSError(f"{source} cannot be opened as a video")

    def __iter__(self) -> Iterator[Picture]:
        while True:
            there, picture = self._capture.read()
            if not there:
                return
            yield picture.astype(np.uint8, copy=False)

    def close(self) -> None:
        self._capture.release()
