"""What the control plane does about what happens, move for move, as the files in `transcripts` say.

A line that begins with `>` is a move; the lines below it are the actions that follow from it. After
a change of what should happen, `python -m tests.control.test_transcripts` writes the files anew, to
be read in the difference.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from collections.abc import Set as AbstractSet
from enum import Enum
from pathlib import Path
from typing import Any

import attrs
from tests.control.world import FACE, NAME, OTHERS, PORTS, Plans, World, discovered
from tests.sweeps import for_all

from uoarm._control.engine import actions as act
from uoarm._control.engine import events as ev
from uoarm._control.engine.placement import Part, Parts, Placement
from uoarm._control.engine.state import ConnectionRecord
from uoarm._support.ordered import OrderedMap
from uoarm.model import FailoverPolicy, Health, Plan, PortRef, ValidationMode

FOLDER = Path(__file__).with_name("transcripts")
FILES = {path.stem: path for path in sorted(FOLDER.glob("*.txt"))}
PLANS = {"face": Plans(FACE), "name": Plans(NAME), "ports": Plans(PORTS)}
CHANGED = {
    (name, change): Plans(OTHERS[change](PLANS[name].text))
    for name, change in itertools.product(("face", "name"), OTHERS)
}
SEEN = {name: Plans(discovered(PLANS[name].text)) for name in ("face", "name")}
POLICIES: dict[str, Callable[[str], object]] = {
    "enabled": lambda text: text == "true",
    "wait": float,
    "return_after": float,
    "limit": int,
}

WHOLE = {
    "do",
    "open",
    "fail",
    "late",
    "old",
    "configure",
}  # moves of which the rest of the line is one word


class Player(World):
    """A world that keeps the actions of each move as text."""

    def __init__(self, robot: str, policy: FailoverPolicy) -> None:
        super().__init__(PLANS[robot], policy)
        self.robot = robot
        self.actions_seen: list[str] = []

    def play(self, move: str) -> list[str]:
        """Make one move and return what the control plane did."""
        self.actions_seen = []
        kind, _, rest = move.partition(" ")
        getattr(self, f"play_{kind}")(*(rest.split() if kind not in WHOLE else (rest,)))
        return self.actions_seen

    def _keep(self, action: act.Action) -> None:
        super()._keep(action)
        self.actions_seen.append(f"  {describe(action)}")

    def play_request(self, identity: str, wanted: str, *options: str) -> None:
        """Options: callback, known (the plan is), a way to validate."""
        self.asked += (f"request {identity}",)
        function, dot, port = wanted.partition(".")
        modes = [
            ValidationMode(option) for option in options if option not in {"callback", "known"}
        ]
        self.post(
            ev.Requested(
                identity,
                PortRef(function, port if dot else None),
                modes[0] if modes else ValidationMode.OFF,
                f"request {identity}",
                self.plans(function, self.dead) if "known" in options else None,
                "callback" in options,
                self.state.revision,
            )
        )

    def play_kill(self, identity: str, *cause: str) -> None:
        """With a cause it is a failure."""
        waiter = f"kill {identity} {len(self.asked)}"
        self.asked += (waiter,)
        self.post(ev.Killed(identity, waiter, " ".join(cause), is_failure=bool(cause)))

    def play_stop(self) -> None:
        waiter = f"stop {len(self.asked)}"
        self.asked += (waiter,)
        self.post(ev.Stopped(waiter))

    def play_die(self, *dead: str) -> None:
        """One or several components, which are a bridge where they are more than one."""
        self.dead |= frozenset(dead)
        if len(dead) == 1:
            self._report(dead[0], Health.LOST)
        else:
            self.post(ev.HealthReported(self.state.bridges[dead[0]], Health.LOST, "it crashed"))

    def play_revive(self, name: str) -> None:
        self.revive(name)

    def play_finish(self, name: str) -> None:
        self.finish(name)

    def play_stale(self, name: str) -> None:
        """Let a component emit too little, and be there all the same."""
        bridge = self.state.bridges[name]
        event = ev.HealthReported(
            bridge, Health.LOST, "too slow", name, "component", is_avoided=True
        )
        self.post(event)

    def play_report(self, subject: str, health: str, part: str, *spared: str) -> None:
        """Of a component, or of a bridge where there is no such component."""
        bridge = self.state.bridges.get(subject, subject)
        component = None if bridge == subject else subject
        event = ev.HealthReported(
            bridge,
            Health(health),
            f"of {part}",
            component,
            part,
            frozenset(map(int, spared)),
            is_avoided=part == "messages" and health == "lost",
            function=f"served by {subject}" if part == "messages" else "",
        )
        self.post(event)

    def play_do(self, lane: str) -> None:
        self.do(self._lane(lane))

    def play_fail(self, argument: str) -> None:
        """What a lane does first; of an opening, `at` and the number of the part that fails."""
        lane, _, at = argument.partition(" at ")
        self.do(self._lane(lane), fails_at=int(at or 0))

    def play_open(self, lane: str) -> None:
        """Let a batch open as a whole, although it was cancelled: that came too late."""
        self.cancelled = frozenset()
        self.do(self._lane(lane))

    def play_late(self, lane: str) -> None:
        """Let a search end that was made with the configuration before."""
        self.do(self._lane(lane), is_late=True)

    def play_old(self, lane: str) -> None:
        """Let a search end that was made with the candidates before."""
        self.do(self._lane(lane), is_old=True)

    def play_see(self) -> None:
        """Discover another camera."""
        self.discover(SEEN[self.robot])

    def play_unsee(self) -> None:
        """See that camera no more, whether it is in use or not."""
        self.discover(PLANS[self.robot])

    def play_replaced(self, name: str) -> None:
        """Have another component of this name for a candidate, while it is not used."""
        number, bridges = self.state.candidates + 1, self.state.bridges
        self.post(ev.CandidatesChanged(bridges, "so it is", number, frozenset({name})))
        self.earlier, self.plans = self.plans, Plans(self.plans.text)

    def play_configure(self, change: str) -> None:
        """To one of the others of this robot, or back."""
        self.configure(self.first if change == "back" else CHANGED[self.robot, change])

    def play_misplace(self, lane: str, *components: str) -> None:
        """Let a search find a plan that avoids these, whatever is excluded."""
        action, *rest = self.lanes.pop(lane)
        assert isinstance(action, act.FindReplacement)
        self.lanes |= {lane: tuple(rest)} if rest else {}
        plan = self.plans(action.plan.function, frozenset(components))
        self.post(ev.ReplacementSought(action.connection, action.attempt, plan))

    def play_nothing(self, lane: str) -> None:
        """Let a search find nothing: what was there as it was looked at is gone again."""
        action, *rest = self.lanes.pop(lane := self._lane(lane))
        assert isinstance(action, act.FindReplacement)
        self.lanes |= {lane: tuple(rest)} if rest else {}
        asked = action.connection, action.attempt
        self.post(ev.ReplacementSought(*asked, None, "it is gone", action.switchover))

    def play_rest(self) -> None:
        """Do all that waits, well."""
        while self.lanes:
            self.do(next(iter(self.lanes)))

    def play_time(self, seconds: str) -> None:
        self.pass_time(float(seconds))

    def _lane(self, beginning: str) -> str:
        """Return the one lane of this name, or of which it is the beginning."""
        (found,) = (
            [beginning]
            if beginning in self.lanes
            else [x for x in self.lanes if x.startswith(beginning)]
        )
        return found


def describe(action: act.Action) -> str:
    """Return an action with all that it says, without what is empty."""
    fields = {field.name: getattr(action, field.name) for field in attrs.fields(type(action))}
    reports = [
        f"{name}={plain(field)}"
        for name, field in fields.items()
        if field or isinstance(field, float)
    ]
    return " ".join([type(action).__name__, *reports])


def plain(value: Any) -> str:
    """Return a value as short as it can be to differ from another."""
    if isinstance(value, Plan):
        return f"{value.function}({','.join(value.names)})"
    if isinstance(value, Placement):
        return value.user
    if isinstance(value, ConnectionRecord):
        output = f" .{value.output}" if value.output else ""
        cause = f" {plain(value.cause)}" if value.cause else ""
        return f"{value.id}:{value.state.value}{output}({','.join(value.components)}){cause}"
    if isinstance(value, Part):
        return "".join(map(str, (value.kind.value, value.id, value.port and f".{value.port}")))
    if isinstance(value, Parts):
        return (
            f"components{plain(value.components)}edges{plain(value.edges)}ports{plain(value.ports)}"
        )
    if isinstance(value, BaseException):
        reason = getattr(value, "reason", None)
        text = f" {reason.value}" if isinstance(reason, Enum) else ""
        return f"{type(value).__name__}({plain(str(value))}{text})"
    if isinstance(value, Enum):
        return str(value.value)
    if isinstance(value, AbstractSet):
        return f"{{{','.join(sorted(map(plain, value)))}}}"
    if isinstance(value, tuple | OrderedMap):
        return f"({','.join(map(plain, value))})"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, str):
        first, *more = value.splitlines()  # why the resolver found nothing is not of interest here
        return f"{first!r}..." if more else repr(value) if " " in value else value
    return repr(value)


def replay(text: str) -> Iterator[str]:
    """Yield a transcript's lines, with the actions that follow from its moves now."""
    lines = text.splitlines()
    robot, *policy = lines[0].removeprefix("robot: ").split()
    options = dict(word.split("=") for word in policy)
    given: Any = {name: POLICIES[name](value) for name, value in options.items()}
    player = Player(robot, FailoverPolicy(**given))
    yield lines[0]
    for line in lines[1:]:
        if line.startswith("> "):
            yield line
            yield from player.play(line[2:])
        elif not line.startswith("  "):
            yield line
    player.settle()
    player.check_at_rest()


@for_all("name", FILES)
def test_each_move_has_the_actions_that_are_written(name: str) -> None:
    text = FILES[name].read_text(encoding="utf-8")
    assert list(replay(text)) == text.splitlines()


if __name__ == "__main__":
    for file in FILES.values():
        said = file.read_text(encoding="utf-8")
        file.write_text("\n".join(replay(said)) + "\n", encoding="utf-8")
