"""Whether a host lives: heard from its token, its pulse and its end, and told once when it died."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from uoarm._host import _keys
from uoarm._host._link import ANSWER_SECONDS, Link
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, UoarmError

__all__ = ["Lifeline"]

_MARGIN_SECONDS = 0.5
_NEWS_SECONDS = 0.3
_LEAST_SECONDS = 0.1


class Lifeline:
    """Keeps what is known of one host's life, and asks it while it lives. For any thread.

    Args:
        name: of the bridge in the host.
        doubted: told that the host does not answer, or does again, and the cause.
        died: told once why it died; `dead` is set already.

    Attributes:
        dead: why it died, "" while it lives.
    """

    def __init__(
        self, name: str, doubted: Callable[[bool, str], None], died: Callable[[str], None]
    ) -> None:
        self._host = f"bridge host {name!r}"
        self._doubted = doubted
        self._died = died
        self._news = threading.Condition()
        self._present = False
        self._given_back = False
        self.dead = ""

    def seen(self, present: bool) -> None:  # noqa: FBT001 - told, not asked
        """Note that the token of the host has come or gone."""
        with self._news:
            self._present = present
            self._news.notify_all()

    def doubt(self, in_doubt: bool) -> None:  # noqa: FBT001 - told, not asked
        """Note that the host does not answer its pulse, or does again."""
        self._doubted(in_doubt, "its bridge host does not answer" if in_doubt else "it answers")

    def die(self, cause: str) -> None:
        """Note that the host died; the first cause counts."""
        with self._news:
            if self.dead or self._given_back:
                return
            self.dead = cause
            self._news.notify_all()
        self._died(cause)

    def give_back(self) -> None:
        """Take no death for news any more: the host is being closed."""
        with self._news:
            self._given_back = True

    def await_token(self, deadline: float) -> None:
        """Return when the host has shown its token, which comes after all that it declares.

        Raises:
            BridgeError: it died before.
            BridgeTimeoutError: it was not ready in time.
        """
        with self._news:
            self._news.wait_for(
                lambda: self._present or bool(self.dead), deadline - time.monotonic()
            )
        if self.dead:
            text = f"{self._host} did not start: {self.dead}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        if not self._present:
            raise BridgeTimeoutError(f"{self._host} was not ready in time")

    def greet(self, link: Link, deadline: float) -> Mapping[str, Any]:
        """Return how the host answers to hello.

        Raises:
            UoarmError: what the host refused with.
        """
        limit = max(_LEAST_SECONDS, deadline - time.monotonic())
        greeting: Mapping[str, Any] = link.ask(_keys.ASK, {"op": "hello"}, timeout=limit)
        return greeting

    def ask(self, link: Link, operation: str, values: Mapping[str, Any]) -> Any:
        """Ask the host for one operation of the contract; waits two minutes at most.

        Raises:
            UoarmError: what the bridge raised.
            BridgeError: UNAVAILABLE when the host is dead; the text says of what it died.
        """
        self._refuse_dead(operation)
        limit = ANSWER_SECONDS
        if "timeout" in values:
            limit = min(limit, values["timeout"] + _MARGIN_SECONDS)
        try:
            return link.ask(_keys.ASK, {"op": operation, **values}, timeout=limit)
        except BridgeError as error:
            if error.reason is not FailureReason.UNAVAILABLE:
                raise
            with self._news:
                self._news.wait_for(lambda: bool(self.dead), _NEWS_SECONDS)
            self._refuse_dead(operation, error)
            raise

    def _refuse_dead(self, operation: str, cause: UoarmError | None = None) -> None:
        if self.dead:
            text = f"{self._host} is dead, {operation!r} is not possible: {self.dead}"
            raise BridgeError(text, FailureReason.UNAVAILABLE) from cause
