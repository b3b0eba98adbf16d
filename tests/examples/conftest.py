"""Footage for the tests of the vision example, by package name from a cache."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "examples" / "vision"))

from vision_demo.footage import Footage, prepare  # noqa: E402 - found once the path is set


@pytest.fixture(scope="session")
def vision() -> Path:
    return ROOT / "examples" / "vision"


@pytest.fixture(scope="session")
def cache() -> Path:
    return Path(os.environ.get("UOARM_CACHE", ROOT / ".cache")) / "vision"


@pytest.fixture(scope="session")
def footage(cache: Path) -> Footage:
    return prepare(cache)
