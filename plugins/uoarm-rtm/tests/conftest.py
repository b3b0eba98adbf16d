"""Everything on loopback, with a naming service and components of this test run."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from hypothesis import settings

sys.path.insert(0, str(Path(__file__).parent))  # for the modules that the tests share

settings.register_profile("rtm-short", max_examples=40, deadline=None, derandomize=True)
settings.register_profile("rtm-long", max_examples=2000, deadline=None)
settings.load_profile(f"rtm-{os.environ.get('HYPOTHESIS_PROFILE', 'short')}")
