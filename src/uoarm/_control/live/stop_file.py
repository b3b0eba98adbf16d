"""The file that is there while everything is stopped, so that a restart begins stopped."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from datetime import datetime, timezone
from pathlib import Path

from uoarm._whole_file import write_whole

__all__ = ["StopFile"]


class StopFile:
    """Whether all is stopped, kept over restarts. Thread safe.

    Args:
        path: of the file; its folder is made when it is needed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()

    def is_there(self) -> bool:
        """Say whether it is there; one that cannot be looked at is taken to be."""
        try:
            self.path.stat()
        except (FileNotFoundError, NotADirectoryError):
            return False
        except OSError:
            return True
        return True

    def settle(self, wanted: Callable[[], bool]) -> None:
        """Have it there, readable by this user only, or not, as is wanted at this moment.

        Raises:
            OSError: it cannot be written or removed.
        """
        with self._lock:  # what is wanted is asked within: the one who settles last asks last
            if not wanted():
                self.path.unlink(missing_ok=True)
            elif not self.is_there():
                self.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                text = (
                    f"stopped {datetime.now(timezone.utc).isoformat()} by process {os.getpid()}\n"
                )
                write_whole(self.path, text.encode(), private=True)

    def remove(self) -> None:
        """Have it there no more.

        Raises:
            OSError: it cannot be removed.
        """
        with self._lock:
            self.path.unlink(missing_ok=True)
