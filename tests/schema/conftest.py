"""Hypothesis profiles: short by default, ``HYPOTHESIS_PROFILE=long`` for a real search."""

from __future__ import annotations

import os

import pytest
from hypothesis import HealthCheck, settings
from tests.schema._official import Group, SuiteMissingError, groups

_RELAXED = (HealthCheck.too_slow, HealthCheck.filter_too_much, HealthCheck.data_too_large)
settings.register_profile(
    "short", max_examples=60, deadline=None, suppress_health_check=_RELAXED, derandomize=True
)
settings.register_profile("long", max_examples=5_000, deadline=None, suppress_health_check=_RELAXED)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "short"))


@pytest.fixture(scope="session")
def official_groups() -> tuple[Group, ...]:
    """The official suite; failing in CI and skipping elsewhere when it cannot be had."""
    try:
        return groups()
    except SuiteMissingError as missing:
        if os.environ.get("CI"):
            pytest.fail(str(missing))
        pytest.skip(str(missing))
