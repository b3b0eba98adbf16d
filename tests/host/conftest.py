"""Links over a unix socket in a folder that is short enough for one; nothing left behind."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from tests.host import hosted

from uoarm._host import remote_bridge
from uoarm._host.transport.zenoh_transport import Transport
from uoarm.testing import Census, patience


@pytest.fixture(scope="session")
def _a_link_has_been(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Have what stays for the next link: Zenoh's own threads."""
    hosted.bridge(tmp_path_factory.mktemp("first")).close()


@pytest.fixture
def nothing_is_left(_a_link_has_been: None) -> Iterator[None]:
    """Hold that threads, descriptors, folders and processes return to where they were."""
    before = Census()
    yield
    before.check()
    left = Path(tempfile.gettempdir()).glob(f"uoarm-host-{os.getpid()}-*")
    assert not list(left)


@pytest.fixture(scope="module")
def unhurried() -> Iterator[None]:
    """For tests in which no host hangs: one that answers late is waited for when it closes."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(remote_bridge, "_CLOSE_SECONDS", patience())
        yield


@pytest.fixture
def ends() -> Iterator[tuple[Transport, Transport]]:
    with tempfile.TemporaryDirectory(prefix="uoarm-test-") as folder:
        place = f"unixsock-stream/{folder}/link"
        near = Transport(place, listen=True)
        far = Transport(place, listen=False)
        yield near, far
        far.close()
        near.close()
