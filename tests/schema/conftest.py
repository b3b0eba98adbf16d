"""What the tests of the checker share."""

from __future__ import annotations

import os

import pytest
from tests.schema._official import Group, SuiteMissingError, groups

from uoarm.schema.regex import compile_pattern, walker_of


@pytest.fixture(scope="session", autouse=True)
def fresh_patterns() -> None:
    """Compile every pattern anew, also where a run is forked off one that has compiled them."""
    compile_pattern.cache_clear()
    walker_of.cache_clear()


@pytest.fixture(scope="session")
def official_groups() -> tuple[Group, ...]:
    """The official suite; failing in CI and skipping elsewhere when it cannot be had."""
    try:
        return groups()
    except SuiteMissingError as missing:
        if os.environ.get("CI"):
            pytest.fail(str(missing))
        pytest.skip(str(missing))
