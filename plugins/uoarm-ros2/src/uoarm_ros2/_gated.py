"""A channel that delivers: when its close returns, the last delivery has ended."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

from uoarm.bridge import Channel
from uoarm.model import Endpoint

__all__ = ["GatedChannel"]

_DRAIN_SECONDS = 4.0


class GatedChannel(Channel):
    """Lets messages through one at a time, and none once it is closed.

    A close from within a delivery does not wait for that delivery.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        super().__init__(endpoint)
        self._gate = threading.Lock()
        self._delivering: int | None = None
        self._from_inside = False

    def close(self, *, timeout: float = 5.0) -> None:
        """Close the link, as the contract says."""
        self._from_inside = self._delivering == threading.get_ident()
        super().close(timeout=timeout)

    def _through(self, take: Callable[[Any], None], message: Any) -> None:
        """Call `take`, unless the channel is closed."""
        with self._gate:
            if self._closed:
                return
            self._delivering = threading.get_ident()
            try:
                take(message)
            finally:
                self._delivering = None

    def _drain(self) -> None:
        """Wait for the delivery that may be under way."""
        if not self._from_inside and self._gate.acquire(timeout=_DRAIN_SECONDS):
            self._gate.release()
