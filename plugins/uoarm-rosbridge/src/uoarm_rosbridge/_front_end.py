"""What this plugin brings to a server."""

from __future__ import annotations

from functools import partial

from uoarm.server.front_end import Backend, FrontEnd, MakeSession, hookimpl
from uoarm_rosbridge._hub import Hub
from uoarm_rosbridge._names import Addresses
from uoarm_rosbridge._rosapi import RosapiCatalogue
from uoarm_rosbridge._session import RosbridgeSession


def _start(backend: Backend) -> MakeSession:
    hub = Hub()
    return partial(
        RosbridgeSession,
        backend=backend,
        hub=hub,
        catalogue=RosapiCatalogue(backend, hub),
        addresses=Addresses(backend.robot),
    )


@hookimpl
def uoarm_front_ends() -> list[FrontEnd]:
    """Return the front end of this plugin."""
    return [
        FrontEnd(
            name="rosbridge",
            summary="rosbridge v2, for clients of ROS on the web",
            path="/rosbridge",
            start=_start,
            contract=1,
        )
    ]
