"""A camera: plays video files, folders of pictures or a device."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2

from uoarm_vision.messages import Frame, Pixel

_PICTURES = {".jpg", ".jpeg", ".png"}


def camera(paths: list[str], every: int = 1, limit: int = 0, width: int = 360) -> Iterator[Frame]:
    """Play videos, folders of pictures, or a device by its number, one after another.

    Args:
        paths: what to play.
        every: of a video, each so many-th picture.
        limit: pictures of each video at most, 0 for all.
        width: pictures are made as wide as this.
    """
    number = 0
    for path in paths:
        for picture in _pictures(path, every, limit):
            height = round(picture.shape[0] * width / picture.shape[1])
            resized = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
            yield {
                "number": number,
                "source": Path(path).name,
                "width": width,
                "height": height,
                "encoding": "bgr8",
                "data": resized.tobytes(),
            }
            number += 1


def _pictures(path: str, every: int, limit: int) -> Iterator[Pixel]:
    if Path(path).is_dir():
        for file in sorted(Path(path).iterdir()):
            if file.suffix.lower() in _PICTURES:
                picture = cv2.imread(str(file))
                if picture is None:
                    raise ValueError(f"{file} is not a picture")
                yield picture
        return
    if not path.isdecimal() and not Path(path).is_file():
        raise FileNotFoundError(f"there is nothing to play at {path}")
    video = cv2.VideoCapture(int(path) if path.isdecimal() else path)
    try:
        count = played = 0
        while not limit or played < limit:
            there, picture = video.read()
            if not there:
                return
            if count % every == 0:
                played += 1
                yield picture
            count += 1
    finally:
        video.release()
