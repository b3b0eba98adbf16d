"""Endpoints and listeners that the tests share."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from uoarm_rtm._orb import limit

from uoarm.bridge import Bridge, Channel
from uoarm.model import Endpoint, Role
from uoarm.testing import slowness, wait

if TYPE_CHECKING:  # the process of a peer has these limits, too, and no `tests` on its path
    from peers import Peer

Make = Callable[..., Bridge]
Start = Callable[..., "Peer"]
# As `call_timeout`, the longest there is: what answers late on a busy machine has not failed.
ANSWERS = 60.0
# As `call_timeout`: within it all answer but what hangs, on a machine that is busy, or stands
# still for some seconds, too.
HANGS_AFTER = max(12.0, 3 * slowness())
# Of calls to what hangs, and to nothing else.
SHORT = 0.5


def endpoint(role: Role, *address: str, **options: Any) -> Endpoint:
    return Endpoint("rtm", "thing", role, address, options=options)


def of(component: str, role: Role, port: str, **options: Any) -> Endpoint:
    """An endpoint of a component that the configuration calls as it is bound, without `.rtc`."""
    return Endpoint("rtm", component, role, (f"{component}.rtc", port), options=options)


def source(bridge: Bridge, at: Endpoint, take: Any) -> Channel:
    structure = bridge.describe(at).message
    assert structure is not None
    return bridge.open_source(at, structure, take)


def sink(bridge: Bridge, at: Endpoint) -> Any:
    structure = bridge.describe(at).message
    assert structure is not None
    return bridge.open_sink(at, structure)


def stamped(data: Any, sec: int = 1) -> Any:
    return {"tm": {"sec": sec, "nsec": 2}, "data": data}


def shorten(bridge: Bridge, path: str) -> None:
    """Give the checks of a component that is to hang a short limit; others answer late, and may."""
    for component in vars(bridge)["_watched"].values():
        if component.peer.path == path:
            component._seconds = SHORT
            limit(component.peer.reference, SHORT)


def checked(bridge: Bridge, path: str = "") -> None:
    """Wait until the bridge has seen which components there are; it reports changes from then on.

    With a path, until it has seen that component alive: others of its name may have died before.
    """
    monitor: Any = vars(bridge)["_monitor"]

    def is_checked() -> bool:
        conditions = {name: item.condition for name, item in (monitor._names or {}).items()}
        if monitor._names is None or None in conditions.values():
            return False
        return not path or conditions.get(path) == "alive"

    wait(is_checked)
