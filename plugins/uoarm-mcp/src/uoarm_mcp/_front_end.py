"""What this plugin brings to a server: an endpoint for agents on a port of its own."""

from __future__ import annotations

from importlib.metadata import version

from uoarm.server.front_end import FrontEnd, HttpPlace, hookimpl


async def _serve(place: HttpPlace) -> None:
    from uoarm_mcp._http import PATH, serve_http  # noqa: PLC0415 - slow, and for who serves it

    del PATH
    await serve_http(place, version("uoarm-mcp"))


@hookimpl
def uoarm_front_ends() -> list[FrontEnd]:
    """Return the front end of this plugin."""
    return [
        FrontEnd(
            name="mcp",
            summary="the Model Context Protocol, for agents",
            path="/mcp",
            serve=_serve,
            contract=1,
        )
    ]
