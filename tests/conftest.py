"""Generated schemas and messages are big, and many are filtered out: that is no fault."""

from __future__ import annotations

from hypothesis import HealthCheck
from tests.profiles import load_profile

load_profile(60, 2000, HealthCheck.filter_too_much, HealthCheck.data_too_large)
