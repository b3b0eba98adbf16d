"""The spare camera: the same footage, played by plain Python without ROS 2."""

from __future__ import annotations

from collections.abc import Iterator

from uoarm_vision.camera import camera as play

from healthbot_parts.messages import View

__all__ = ["camera"]


def camera(path: str, rate: float = 5.0) -> Iterator[View]:
    """Yield pictures of a file or folder again and again.

    Args:
        path: what is played; `$NAME` is replaced from the environment.
        rate: pictures a second.
    """
    for frame in play(path, rate=rate, loop=True):
        yield {
            "width": frame["width"],
            "height": frame["height"],
            "encoding": "bgr8",
            "data": frame["data"],
        }
