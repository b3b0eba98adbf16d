"""Paths of the user who runs this: `~` in what is configured, and where programs keep things."""

from __future__ import annotations

import os
from pathlib import Path

from uoarm.errors import UsageError

_FOLDERS = {"cache": "~/.cache", "data": "~/.local/share", "state": "~/.local/state"}


def expanded(path: str | Path) -> Path:
    """Return a path in which `~` and `~NAME` are replaced.

    They stay where no home is known: what is wrong with the path names it as it was written.
    """
    return Path(os.path.expanduser(path))  # noqa: PTH111 - that of pathlib raises RuntimeError


def user_folder(kind: str) -> Path:
    """Return where uoarm keeps what is of this user: `cache`, `data` or `state`.

    These are the folders of https://specifications.freedesktop.org/basedir-spec; they need not be
    there yet.

    Raises:
        UsageError: the user has no home, and no variable names a folder.
    """
    variable = f"XDG_{kind.upper()}_HOME"
    named = os.environ.get(variable) or _FOLDERS[kind]
    folder = expanded(named)
    if str(folder).startswith("~"):
        text = f"{named}: this user has no home: set {variable} to a folder that can be written"
        raise UsageError(text)
    return folder / "uoarm"
