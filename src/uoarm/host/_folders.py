"""Where environments of hosts live, and the folders of links, which are short-lived."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from pathlib import Path

from uoarm.host._keys import FOLDER

__all__ = ["environment_folder", "environment_python", "environments_home", "link_folder"]

_OWNED = re.compile(re.escape(FOLDER) + r"(\d+)-")


def environments_home() -> Path:
    """Return the folder of all environments: `UOARM_HOME`, else where the user's data lies."""
    home = os.environ.get("UOARM_HOME")
    if home:
        return Path(home) / "environments"
    data = os.environ.get("XDG_DATA_HOME") or "~/.local/share"
    return Path(data).expanduser() / "uoarm" / "environments"


def environment_folder(name: str) -> Path:
    """Return where the environment of this name is, or would be."""
    return environments_home() / name


def environment_python(name: str) -> Path:
    """Return the interpreter of an environment, which may not be there."""
    return environment_folder(name) / "bin" / "python"


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
