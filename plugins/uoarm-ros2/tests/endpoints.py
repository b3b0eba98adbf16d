"""Endpoints and listeners that the tests share."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from peers import Peer

from uoarm import Connection
from uoarm.bridge import Bridge, Channel, Sink, Source
from uoarm.model import Endpoint, Role
from uoarm.testing import wait

INT64 = "std_msgs/msg/Int64"
Make = Callable[..., Bridge]
Start = Callable[..., Peer]


def endpoint(role: Role, *address: str, port: str = "default", **options: Any) -> Endpoint:
    return Endpoint("ros", "thing", role, address, port=port, options=options)


def source(bridge: Bridge, at: Endpoint, take: Any) -> Source:
    structure = bridge.describe(at).message
    assert structure is not None
    return bridge.open_source(at, structure, take)


def sink(bridge: Bridge, at: Endpoint) -> Any:
    structure = bridge.describe(at).message
    assert structure is not None
    return bridge.open_sink(at, structure)


def known(bridge: Bridge, *nodes: str, bare: bool = False) -> None:
    """Wait until the bridge sees these nodes with their endpoints; bare ones have none."""
    wait(
        lambda: (
            {component.name for component in bridge.discover() if bare or component.endpoints}
            >= set(nodes)
        )
    )


def matched(channel: Channel, count: int) -> None:
    """Wait until a channel has so many peers."""
    wait(lambda: channel.facts()["matched"] == count)


def reaches(peer: Peer, topic: str, connection: Connection) -> bool:
    """Publish a number, and say whether one has come.

    The subscription of a plan that was lost is there until another plan runs. Its publisher may
    know of that one only.
    """
    peer.do("publish", topic=topic, count=1)
    try:
        return bool(connection.get(0) == {"data": 1})
    except TimeoutError:
        return False


def await_quiet_watch(out: Sink) -> None:
    """Wait for the thread that a bridge has from its first sink on, and close this one.

    It begins with the next turn of the bridge's loop: sinks that were closed by then started none.
    """
    wait(lambda: any(thread.name.endswith(" quiet") for thread in threading.enumerate()))
    out.close()


def write(folder: Path, **files: str) -> Path:
    """Write definitions into a folder: `package__msg__Name` is the file of a type."""
    for name, text in files.items():
        package, kind, own = name.split("__")
        path = folder / package / kind / f"{own}.{kind}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder
