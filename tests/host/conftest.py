"""Links over a unix socket in a folder that is short enough for one."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator

import pytest

from uoarm.host._link import Link


@pytest.fixture
def ends() -> Iterator[tuple[Link, Link]]:
    with tempfile.TemporaryDirectory(prefix="uoarm-test-") as folder:
        place = f"unixsock-stream/{folder}/link"
        near = Link(place, listen=True)
        far = Link(place, listen=False)
        yield near, far
        far.close()
        near.close()
