"""Hypothesis profiles: short by default, ``HYPOTHESIS_PROFILE=long`` for a real search."""

from __future__ import annotations

import os

from hypothesis import HealthCheck, settings

# Generated schemas and messages are big, and many are filtered out: slow examples are no fault.
_RELAXED = (HealthCheck.too_slow, HealthCheck.filter_too_much, HealthCheck.data_too_large)
# The short profile tries the same examples every time; the long one looks further.
settings.register_profile(
    "short", max_examples=60, deadline=None, suppress_health_check=_RELAXED, derandomize=True
)
settings.register_profile("long", max_examples=2000, deadline=None, suppress_health_check=_RELAXED)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "short"))
