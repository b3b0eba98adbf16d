"""Activate on request, deactivate on kill: components are ACTIVE for as long as we use them."""

from __future__ import annotations

import logging
import threading

from uoarm.bridge import Channel
from uoarm.errors import BridgeError
from uoarm_rtm._control import change
from uoarm_rtm._peer import PeerComponent, state_of
from uoarm_rtm._options import RtmEndpointOptions

__all__ = ["Activations"]

_log = logging.getLogger("uoarm.rtm")


class Activations:
    """Counts which channels need which component ACTIVE.

    A component that was ACTIVE before stays so afterwards: only what we began is ended.

    Args:
        seconds: limit of each call.
    """

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._lock = threading.Lock()
        self._ours: dict[str, PeerComponent] = {}
        self._users: dict[str, set[Channel]] = {}

    def enter(
        self, channel: Channel, peer: PeerComponent, options: RtmEndpointOptions
    ) -> None:
        """Have a component ACTIVE while a channel is open, where its endpoint asks for that.

        One that has failed (ERROR) is reset before, where the endpoint allows it.

        Raises:
            BridgeError: it cannot be activated.
        """
        if not options.activate:
            return
        with self._lock:
            state = state_of(peer, self._seconds)
            if state == "error" and options.reset:
                change(peer, "reset", self._seconds, there_is_fine=True)
            if state != "active":
                change(peer, "activate", self._seconds, there_is_fine=True)
                self._ours[peer.path] = peer
            self._users.setdefault(peer.path, set()).add(channel)

    def tick(self) -> None:
        """Deactivate what we activated and no open channel needs."""
        with self._lock:
            for path, users in list(self._users.items()):
                users -= {user for user in users if user.closed}
                if users:
                    continue
                del self._users[path]
                peer = self._ours.pop(path, None)
                if peer is None:
                    continue
                try:
                    if state_of(peer, self._seconds) != "error":  # which is not active either
                        change(peer, "deactivate", self._seconds, there_is_fine=True)
                except BridgeError as error:
                    _log.warning("component %s could not be deactivated: %s", path, error)
