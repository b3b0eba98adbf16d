"""Links of both kinds, and nothing left behind."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from uoarm._host import remote_bridge
from uoarm._host.transport.frames import LinkSockets
from uoarm._host.transport.socket_transport import SocketTransport
from uoarm._host.transport.transport import Transport
from uoarm._host.transport.zenoh_transport import ZenohTransport
from uoarm.testing import ResourceSnapshot, free_port, patience


@pytest.fixture
def nothing_is_left() -> Iterator[None]:
    """Hold that threads, descriptors and processes return to where they were."""
    before = ResourceSnapshot()
    yield
    before.check()


@pytest.fixture(scope="module")
def unhurried() -> Iterator[None]:
    """For tests in which no host hangs: one that answers late is waited for when it closes."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(remote_bridge, "_CLOSE_SECONDS", patience())
        yield


@pytest.fixture(params=["socket", "zenoh"])
def ends(request: pytest.FixtureRequest) -> Iterator[tuple[Transport, Transport]]:
    """Both ends of a link of either kind."""
    near: Transport
    far: Transport
    if request.param == "socket":
        one, other = LinkSockets.make()
        near, far = SocketTransport(one, "near"), SocketTransport(other, "far")
    else:
        place = f"tcp/127.0.0.1:{free_port()}"
        near = ZenohTransport(place, listen=True)
        far = ZenohTransport(place, listen=False)
    yield near, far
    far.close()
    near.close()
