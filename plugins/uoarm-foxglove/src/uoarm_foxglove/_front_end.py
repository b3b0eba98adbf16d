"""What this plugin brings to a server."""

from __future__ import annotations

from uoarm.server.front_end import Backend, Client, FrontEnd, MakeSession, Session, hookimpl
from uoarm_foxglove._catalogue import ChannelCatalogue
from uoarm_foxglove._session import FoxgloveSession

__all__ = ["uoarm_front_ends"]


def _start(backend: Backend) -> MakeSession:
    catalogue = ChannelCatalogue(backend)

    def make_session(client: Client) -> Session:
        return FoxgloveSession(client, backend, catalogue)

    return make_session


@hookimpl
def uoarm_front_ends() -> list[FrontEnd]:
    """Return the front end of this plugin."""
    return [
        FrontEnd(
            name="foxglove",
            summary="the Foxglove WebSocket protocol, for viewers",
            path="/foxglove",
            start=_start,
            # The second is what viewers asked for before; each refuses a server without its own.
            subprotocols=("foxglove.sdk.v1", "foxglove.websocket.v1"),
            contract=1,
        )
    ]
