"""Progress, plan, live status and the table at the end, for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable

from attrs import define, field
from rich.console import Console, Group, RenderableType
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from uoarm import Plan, StatusMap
from vision_demo.tally import Tally

__all__ = ["LiveStatus", "bar", "result_table", "show_plan"]


def bar(console: Console) -> Progress:
    """Return a progress bar that counts."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=console,
    )


def show_plan(console: Console, plan: Plan) -> None:
    """Print the plan and what was passed over, with reasons."""
    console.print(str(plan), markup=False, highlight=False, soft_wrap=True)
    console.print()


@define
class LiveStatus:
    """Looks at the status map while a connection runs, and shows it with a progress bar.

    `last` is the last look at which the whole chain was still open.
    """

    look: Callable[[], StatusMap]
    last: StatusMap = field(factory=StatusMap)

    def update(self) -> None:
        """Look again; what is being closed is not worth keeping."""
        status = self.look()
        if len(status.routes) >= len(self.last.routes):
            self.last = status

    def shown(self, progress: Progress) -> RenderableType:
        """Return the routes at the last look, and the bar."""
        return Group(_routes(self.last), progress)


def _routes(status: StatusMap) -> Table:
    table = Table(title="live status", title_justify="left", pad_edge=False, box=None)
    for name in ("from", "to"):
        table.add_column(name)
    for name in ("messages", "a second", "age", "dropped"):
        table.add_column(name, justify="right")
    for route in status.routes:
        table.add_row(
            route.producer.removesuffix(".default"),
            route.consumer.removesuffix(".default"),
            str(route.delivered),
            "-" if route.rate is None else f"{route.rate:.1f}",
            "-" if route.age is None else f"{route.age:.2f} s",
            str(sum(times for _, times in route.dropped)),
        )
    return table


def result_table(tally: Tally, facts: Iterable[tuple[str, str]]) -> RenderableType:
    """Return who was seen in what, and the facts of the run."""
    seen = Table(title="who was seen", title_justify="left", pad_edge=False, box=None)
    for name in ("footage", "shows"):
        seen.add_column(name)
    seen.add_column("frames", justify="right")
    seen.add_column("recognised")
    for source, person in tally.expected.items():
        counted = tally.seen.get(source, Counter())
        found = ", ".join(f"{name or 'unknown'} {n}" for name, n in counted.items())
        seen.add_row(source, person or "a stranger", str(tally.frames[source]), found or "no one")
    rest = Table(show_header=False, pad_edge=False, box=None)
    for fact in facts:
        rest.add_row(*fact)
    return Group("", seen, "", rest)
