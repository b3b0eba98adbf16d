"""Become another program that the kernel ends when the scene dies, however it dies (Linux)."""

from __future__ import annotations

import ctypes
import os
import signal
import sys

_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def main() -> None:
    """Run `PARENT PROGRAM ARGUMENT...` in this process."""
    parent, program, *arguments = sys.argv[1:]
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() == int(parent):  # else it died before the kernel was asked
        os.execv(program, [program, *arguments])  # noqa: S606 - the program is the scene's own


if __name__ == "__main__":
    main()
