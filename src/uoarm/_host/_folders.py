"""The folders of links: private, short-lived, and swept when their makers died."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from pathlib import Path

from uoarm._host._keys import FOLDER

__all__ = ["link_folder"]

_OWNED = re.compile(re.escape(FOLDER) + r"(\d+)-")


def link_folder() -> Path:
    """Make a folder that only this user can enter, for the socket of one link.

    Removes what processes left behind that were killed while their hosts started.
    """
    home = Path(tempfile.gettempdir())
    for left in home.glob(f"{FOLDER}*"):
        owner = _OWNED.match(left.name)
        if owner is not None and not _lives(int(owner[1])):
            shutil.rmtree(left, ignore_errors=True)  # another user's folder stays, as it should
    return Path(tempfile.mkdtemp(prefix=f"{FOLDER}{os.getpid()}-"))


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        pass
    return True
