"""Who waits at a terminal for bridges gets a notice."""

from __future__ import annotations

import os
import select
import sys

import pytest

from uoarm.cli import _show
from uoarm.testing import patience


def test_waiting_for_a_plan_at_a_terminal_says_for_what_and_how_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ours, theirs = os.openpty()
    monkeypatch.setattr(_show, "_SILENT_SECONDS", 0.0)
    try:
        with os.fdopen(theirs, "w") as terminal:
            monkeypatch.setattr(sys, "stderr", terminal)
            with _show._saying_that_it_waits(7.0):
                assert select.select([ours], [], [], patience())[0]
                assert b"waiting for bridges to start" in os.read(ours, 4096)
            monkeypatch.undo()
    finally:
        os.close(ours)
