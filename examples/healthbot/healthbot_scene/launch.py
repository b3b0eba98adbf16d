"""Become another program that the kernel ends when the scene dies, however it dies (Linux)."""

from __future__ import annotations

import os
import sys

from uoarm._host import die_with_parent


def main() -> None:
    """Run `PARENT PROGRAM ARGUMENT...` in this process."""
    parent, program, *arguments = sys.argv[1:]
    if die_with_parent(int(parent)):
        os.execv(program, [program, *arguments])  # noqa: S606 - the program is the scene's own


if __name__ == "__main__":
    main()
