"""Shared settings of the tests; everything is on loopback or on a pseudo-terminal."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # for the modules that the tests share

from tests.profiles import load_profile  # type: ignore[import-not-found]

load_profile(100, 5000)
