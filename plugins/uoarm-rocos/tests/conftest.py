"""Shared settings of the tests; everything is on loopback or on a pseudo-terminal."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))  # for the modules that the tests share

settings.register_profile("rocos-short", max_examples=100, deadline=None, derandomize=True)
settings.register_profile("rocos-long", max_examples=5000, deadline=None)
settings.load_profile(f"rocos-{os.environ.get('HYPOTHESIS_PROFILE', 'short')}")
