"""Hypothesis profiles: short by default, ``HYPOTHESIS_PROFILE=long`` for a real search."""

from __future__ import annotations

import os

import pytest
from hypothesis import HealthCheck, settings
from xdist.remote import Producer
from xdist.scheduler import LoadScopeScheduling

# One worker runs all tests of these, so that the scene is started once.
TOGETHER = {"tests/examples/test_healthbot.py"}

# Generated schemas and messages are big, and many are filtered out: slow examples are no fault.
_RELAXED = (HealthCheck.too_slow, HealthCheck.filter_too_much, HealthCheck.data_too_large)
# The short profile tries the same examples every time; the long one looks further.
settings.register_profile(
    "short", max_examples=60, deadline=None, suppress_health_check=_RELAXED, derandomize=True
)
settings.register_profile("long", max_examples=2000, deadline=None, suppress_health_check=_RELAXED)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "short"))


class Scheduler(LoadScopeScheduling):  # type: ignore[misc]  # xdist has no types
    """Hands single tests to workers; those of a module that starts something big stay together.

    (xdist has a mark for that, which pytest 9.2 leaves without effect.)
    """

    def _split_scope(self, nodeid: str) -> str:
        module = nodeid.partition("::")[0]
        return module if module in TOGETHER else nodeid


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> Scheduler | None:
    return Scheduler(config, log) if config.getvalue("dist") == "load" else None
