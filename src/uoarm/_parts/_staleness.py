"""Stale outputs: those that emit fewer messages than the configuration expects of them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeAlias

from attrs import define, field

from uoarm._dataplane import Clock, Route
from uoarm._parts._component import LiveComponent, LiveEdge
from uoarm.bridge import HealthEvent
from uoarm.model import Expectation, Health

_CALM_SECONDS = 0.1
_ENOUGH = 0.5

_Output: TypeAlias = tuple[LiveComponent, str]


@define(eq=False)
class _Window:
    """What one output has done since a moment, and what reached its component meanwhile.

    Attributes:
        feeds: those into the component's inputs; of a native link it is not known what passes.
        count: of the messages of that route at the beginning.
        reached: how many had passed each of the feeds then.
    """

    route: Route
    feeds: frozenset[Route]
    began: float
    count: int = field(init=False)
    reached: dict[Route, int] = field(init=False)

    def __attrs_post_init__(self) -> None:
        self.count = self.route.received
        self.reached = {feed: _passed(feed) for feed in self.feeds}

    def emitted(self) -> int:
        return self.route.received - self.count

    def fed(self) -> list[int]:
        """Return how many messages each feed gave that were for the component to deal with."""
        return [_passed(feed) - count for feed, count in self.reached.items()]


class StalenessWatch:
    """Looks at the outputs that are open and reports those that are stale as lost.

    An output is stale when, over its whole patience, it emitted less than half of what it is
    expected to, or of what reached each of its component's inputs where that is less: one that
    gets too little to work on is not to blame. What feeds one of which something is expected is
    itself expected to emit at all. It counts from when the first consumer is attached to an
    output, and anew from when something else feeds its component.
    """

    def __init__(
        self,
        components: Callable[[], Iterable[LiveComponent]],
        edges: Callable[[], Iterable[LiveEdge]],
        report: Callable[[HealthEvent], None],
        clock: Clock,
    ) -> None:
        self._components = components
        self._edges = edges
        self._report = report
        self._clock = clock
        self._windows: dict[_Output, _Window] = {}
        self._changed = threading.Event()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._run, name="uoarm-stale", daemon=True)

    def start(self) -> None:
        """Look when one may be stale, and after changes. Idempotent; by one thread at a time."""
        if self._thread.ident is None:
            self._thread.start()

    def close(self) -> None:
        """Look no more."""
        self._stopped.set()
        self._changed.set()

    def changed(self) -> None:
        """Look soon: something was opened, attached or closed. From any thread; quick."""
        self._changed.set()

    def look(self) -> float | None:
        """Look once; return in how many seconds one may be stale, None where none can be."""
        now = self._clock()
        before, self._windows = self._windows, {}
        due: list[float] = []
        edges: dict[LiveComponent, list[LiveEdge]] = {}
        for joined in self._edges():
            edges.setdefault(joined.consumer, []).append(joined)
        for (live, output), expect in self._expectations(edges).items():
            routes = live.outlets[output].routes
            if not routes:
                due.append(expect.patience)  # an offer may attach one without an event
                continue
            routed = (joined.route for joined in edges.get(live, ()))
            feeds = frozenset(route for route in routed if route is not None)
            window = before.get((live, output))
            if window is None or window.route not in routes or window.feeds != feeds:
                window = _Window(routes[0], feeds, now)
            self._windows[live, output] = window = self._judge(live, output, expect, window, now)
            due.append(window.began + expect.patience - now)
        return min(due, default=None)

    def _expectations(
        self, edges: Mapping[LiveComponent, Sequence[LiveEdge]]
    ) -> Mapping[_Output, Expectation]:
        """Return what is expected of each output, declared or by what it feeds.

        Args:
            edges: by what they feed: of hundreds, each look would take their number squared.
        """
        found = {
            (live, output.name): output.expect
            for live in self._components()
            for output in live.component.outputs
            if output.expect is not None
        }
        waiting = list(found)
        for live, output in waiting:
            patience = found[live, output].patience
            for joined in edges.get(live, ()):
                key = joined.producer, joined.edge.output
                if key not in found:
                    found[key] = Expectation(1 / patience, patience)
                    waiting.append(key)
        return found

    def _judge(
        self, live: LiveComponent, port: str, expect: Expectation, window: _Window, now: float
    ) -> _Window:
        """Report an output whose window is over and too empty; return the window to go on with."""
        lasted = now - window.began
        if lasted < expect.patience:
            return window
        count = window.emitted()
        if count < _ENOUGH * min([expect.rate * lasted, *window.fed()]):
            cause = (
                f"output {port!r} is stale: {count / lasted:.2g} messages a second over "
                f"{lasted:.2g} s, {expect.rate:.3g} are expected{_refused(window)}"
            )
            name = live.component.name
            self._report(HealthEvent(live.component.bridge, Health.LOST, cause, component=name))
        return _Window(window.route, window.feeds, now)

    def _run(self) -> None:
        # Many changes come at once: they are looked at together.
        while not self._stopped.wait(_CALM_SECONDS):
            self._changed.clear()  # before the look, which sees what changed until then
            self._changed.wait(self.look())


def _refused(window: _Window) -> str:
    """Say what it was given last and did not take, for the end of a sentence."""
    refused = (feed for feed in window.feeds if feed.refusal)
    return "".join(
        f"; the last message of {feed.producer} -> {feed.consumer} was refused: {feed.refusal}"
        for feed in refused
    )


def _passed(feed: Route) -> int:
    """Return how many messages came that were not wrong: of those its consumer gets none."""
    return feed.received - feed.invalid
