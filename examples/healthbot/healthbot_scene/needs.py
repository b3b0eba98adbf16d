"""What the scene needs beside Python packages, and what does not run without each."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from importlib.util import find_spec
from typing import Final

from attrs import frozen

__all__ = ["MODULES", "NEEDS", "Need", "chromium", "missing", "node"]

_NODE = (20, 10)
_SECONDS = 10.0
_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@frozen
class Need:
    """Something that may be missing.

    Attributes:
        name: for people.
        there: looks for it.
        install: what to do where it is missing.
        without: what happens then.
        vital: whether nothing at all runs without it.
    """

    name: str
    there: Callable[[], bool]
    install: str
    without: str
    vital: bool = False

    def __str__(self) -> str:
        return f"{self.name} is not here ({self.install}): {self.without}"


def missing() -> list[Need]:
    """Return what is not here, the vital first."""
    return sorted((need for need in NEEDS if not need.there()), key=lambda need: not need.vital)


def node() -> str | None:
    """Return Node.js with WebSocket, which an option of 20.10 and every later version has."""
    program = shutil.which("node")
    if program is None:
        return None
    try:
        text = subprocess.run(
            [program, "--version"], capture_output=True, text=True, timeout=_SECONDS, check=False
        ).stdout.strip()
        version = tuple(int(part) for part in text.removeprefix("v").split(".")[:2])
    except (OSError, ValueError, subprocess.TimeoutExpired):
        return None
    return program if version >= _NODE else None


def chromium() -> str | None:
    """Return a Chromium that a program can drive."""
    return next((found for name in _BROWSERS if (found := shutil.which(name))), None)


def _package(module: str, install: str, without: str, *, vital: bool = True) -> Need:
    def there() -> bool:
        return find_spec(module) is not None

    return Need(f"the Python module {module}", there, install, without, vital=vital)


_ALL = "`make healthbot` installs it"
_NOTHING = "the scene does not start"

MODULES: Final = ("cv2", "omniORB", "uoarm_rtm", "uoarm_rocos", "serial", "msgpack", "websockets",
            "httpx", "starlette", "sqlalchemy", "uvicorn")  # fmt: skip

NEEDS = (
    _package("rclpy", _ALL + ", or source a ROS 2 installation first", _NOTHING),
    *(_package(module, _ALL, _NOTHING) for module in MODULES),
    _package("dlib", _ALL, "the lighter recogniser goes on, which mixes people up", vital=False),
    _package("espeakng_loader", _ALL, "what is said is shown, not spoken", vital=False),
    Need(
        "Node.js 20.10 or later",
        lambda: node() is not None,
        "Debian: apt install nodejs",
        "the terminal application and --visit do not run; the browser's does",
    ),
    Need(
        "Chromium",
        lambda: chromium() is not None,
        "Debian: apt install chromium",
        "the browser's rows of two experiments stay empty; any browser shows the page",
    ),
)
