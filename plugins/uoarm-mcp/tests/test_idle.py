"""A server for agents takes hardly any processor time while none asks."""

from __future__ import annotations

from collections.abc import Callable

from conftest import Serve
from uoarm.testing import wait


def test_without_agents_nothing_is_looked_at_often(
    waits: Callable[[str], list[float]], serve: Serve
) -> None:
    """HTTP servers of a library look ten times a second whether they are to end."""
    serve()
    looks = waits("uoarm-serve")
    looks.clear()  # those of its start
    wait(lambda: len(looks) >= 3)
    assert min(looks) >= 0.5
