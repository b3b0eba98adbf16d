"""Stale outputs: those that emit fewer messages than the configuration expects of them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable

from attrs import define

from uoarm.bridge import HealthEvent
from uoarm.flow import Clock, Route
from uoarm.manager._live import LiveComponent
from uoarm.model import Expectation, Health

__all__ = ["StalenessWatch"]

_LOOK_SECONDS = 0.1
_ENOUGH = 0.5


@define(eq=False)
class _Window:
    """What one output has done since a moment, seen at one of its routes."""

    route: Route
    began: float
    received: int


class StalenessWatch:
    """Looks at the outputs that are open and reports those that are stale as lost.

    An output is stale when, over its whole patience, it emitted less than half of what it is
    expected to. It counts from when the first consumer is attached to it.

    Args:
        components: gives what is open now.
        report: takes the health event of a component that is stale.
        clock: seconds that only grow.
    """

    def __init__(
        self,
        components: Callable[[], Iterable[LiveComponent]],
        report: Callable[[HealthEvent], None],
        clock: Clock,
    ) -> None:
        self._components = components
        self._report = report
        self._clock = clock
        self._windows: dict[tuple[LiveComponent, str], _Window] = {}
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="uoarm-stale", daemon=True)

    def start(self) -> None:
        """Look ten times a second from now on."""
        self._thread.start()

    def close(self) -> None:
        """Look no more."""
        self._stopped.set()

    def look(self) -> None:
        """Look once."""
        now = self._clock()
        before, self._windows = self._windows, {}
        for live in self._components():
            if live.condition.health is Health.LOST:
                continue
            for output in live.component.outputs:
                routes = live.outlets[output.name].routes
                if output.expect is None or not routes:
                    continue
                key = live, output.name
                window = before.get(key)
                if window is None or window.route not in routes:
                    window = _Window(routes[0], now, routes[0].received)
                self._windows[key] = self._judge(live, output.name, output.expect, window, now)

    def _judge(
        self, live: LiveComponent, port: str, expect: Expectation, window: _Window, now: float
    ) -> _Window:
        """Report an output whose window is over and too empty; return the window to go on with."""
        lasted = now - window.began
        if lasted < expect.patience:
            return window
        count = window.route.received - window.received
        if count < _ENOUGH * expect.rate * lasted:
            cause = (
                f"output {port!r} is stale: {count / lasted:.2g} messages a second over "
                f"{lasted:.2g} s, {expect.rate:g} are expected"
            )
            name = live.component.name
            self._report(HealthEvent(live.component.bridge, Health.LOST, cause, component=name))
        return _Window(window.route, now, window.route.received)

    def _run(self) -> None:
        while not self._stopped.wait(_LOOK_SECONDS):
            self.look()
