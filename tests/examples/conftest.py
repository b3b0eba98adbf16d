"""Footage for the tests of the vision example, by package name from a cache."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from vision_demo.footage import Footage

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "examples" / "vision"))


@pytest.fixture(scope="session")
def vision() -> Path:
    return ROOT / "examples" / "vision"


@pytest.fixture(scope="session")
def cache() -> Path:
    return Path(os.environ.get("UOARM_CACHE", ROOT / ".cache")) / "vision"


@pytest.fixture(scope="session")
def footage(cache: Path) -> Footage:
    from vision_demo.footage import prepare  # needs OpenCV

    return prepare(cache)
