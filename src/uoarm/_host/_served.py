"""One bridge of a joined host, from when a manager takes it up until it is let go or lost."""

from __future__ import annotations

import logging
import threading
from threading import Event

from uoarm._host import _keys
from uoarm._host._link import Link
from uoarm._host._serving import Serving
from uoarm.bridge import Registry
from uoarm.errors import UoarmError
from uoarm.model import BridgeSpec

__all__ = ["Served"]

_CLOSE_SECONDS = 5.0
_log = logging.getLogger("uoarm")


class Served:
    """One bridge while one manager uses it; closed when the manager says so, or its token goes.

    Args:
        registry: the plugins.
        spec: the bridge.
        link: to the manager, for this bridge alone; closed with it.

    Attributes:
        name: of the bridge.

    Raises:
        UoarmError: the bridge could not be made.
    """

    def __init__(self, registry: Registry, spec: BridgeSpec, link: Link) -> None:
        self.name = spec.name
        self._link = link
        self._ended = Event()
        link.watch_alive(_keys.MANAGED, self._managed)
        try:
            self._bridge = registry.create(spec)
        except BaseException:
            link.close()
            raise
        self._serving = Serving(self._bridge, link, self._ended)
        self._serving.begin()
        self._thread = threading.Thread(
            target=self._wait, name=f"uoarm-served-{spec.name}", daemon=True
        )
        self._thread.start()
        _log.info("bridge %s is taken up", self.name)

    @property
    def is_leaving(self) -> bool:
        """Whether its manager has gone, or let it go."""
        return self._ended.is_set()

    @property
    def has_left(self) -> bool:
        """Whether it is closed."""
        return not self._thread.is_alive()

    def let_go(self) -> None:
        """Begin to close the bridge; returns at once."""
        self._ended.set()

    def end(self) -> None:
        """Close the bridge and wait until that is done, five seconds at most."""
        self.let_go()
        self._thread.join(_CLOSE_SECONDS)

    def _managed(self, present: bool) -> None:  # noqa: FBT001 - told, not asked
        if not present:
            self._ended.set()

    def _wait(self) -> None:
        self._ended.wait()
        try:
            self._bridge.close()
        except UoarmError as error:
            _log.warning("%s", error)
        self._serving.end()
        self._link.close()
        _log.info("bridge %s is let go", self.name)
