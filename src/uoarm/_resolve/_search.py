"""The search: depth first by priority, with conflict-directed backjumping.

Variables are functions, values their components. A function is assigned when a chosen component
demands it; the plan found is the first that plain depth-first backtracking would find (the
function asked for first, then its inputs in order, each with all that it needs before the next).
When no component of a function is left, the search jumps to the latest choice that had a part in
the failure. A function that fails for no choice's fault is remembered as impossible. The stack is
explicit, so that a chain of any length resolves.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from attrs import define, field

from uoarm._resolve._catalogue import Structures
from uoarm._resolve._proofs import EdgeChecks, command_mistakes, lifetime_warnings
from uoarm.errors import ResolutionError
from uoarm.model import Component, Edge, Function, Input, Plan, Reason, Rejection, Step

_RECORDED = "x-recorded"  # marks structures of the bridge `recording`
_CHECK_SECONDS = 30.0


@define
class _Agenda:
    """Functions that are still to be assigned, as a linked list that backtracking can share."""

    function: str
    rest: _Agenda | None


@define
class _Frame:
    """One function, the components tried for it, and whose choices spoilt those."""

    function: Function
    agenda: _Agenda | None
    depth: int
    introducer: int | None
    next_candidate: int = 0
    chosen: Component | None = None
    structures: Structures | None = None
    edges: list[Edge] = field(factory=list)
    warnings: list[str] = field(factory=list)
    culprits: set[int] = field(factory=set)
    rejected: list[Rejection] = field(factory=list)


@define
class _Refusal:
    """Why a candidate does not do, and the depths of the choices that had a part in it."""

    reasons: tuple[Reason, ...]
    culprits: set[int] = field(factory=set)
    because_of: tuple[Rejection, ...] = ()


@define(eq=False)
class Search:
    """One search for one plan; used once.

    Args:
        fit: judges components and edges, memoised.
        excluded: names of components that may not be used.
        budget: candidates tried at most.
        clock: a monotonic clock, in seconds.

    Attributes:
        seconds_unavailable: spent on components that were not available; None: all were.
    """

    _functions: Mapping[str, Function]
    _fit: EdgeChecks
    _excluded: frozenset[str]
    _budget: int
    _clock: Callable[[], float]
    seconds_unavailable: float | None = field(default=None, init=False)
    _checked: float = field(default=0.0, init=False)
    _frames: list[_Frame] = field(factory=list, init=False)
    _assigned: dict[str, _Frame] = field(factory=dict, init=False)
    _demands: dict[str, list[tuple[int, Component, Input]]] = field(factory=dict, init=False)
    _impossible: dict[str, tuple[Rejection, ...]] = field(factory=dict, init=False)

    def run(self, name: str) -> Plan | tuple[Rejection, ...]:
        """Return the plan, or the rejected candidates of the function asked for.

        Raises:
            ResolutionError: the budget ran out, or the time for checking structures.
        """
        self._push(name, None, None)
        while True:
            frame = self._frames[-1]
            if self._choose(frame):
                agenda = frame.agenda
                while agenda is not None and agenda.function in self._assigned:
                    agenda = agenda.rest
                if agenda is None:
                    return self._plan(name)
                introducer = self._demands[agenda.function][0][0]
                self._push(agenda.function, agenda.rest, introducer)
            elif not self._jump_back(frame):
                return tuple(frame.rejected)

    def _push(self, name: str, rest: _Agenda | None, introducer: int | None) -> None:
        depth, function = len(self._frames), self._functions[name]
        frame = _Frame(function, rest, depth, introducer)
        frame.rejected += (
            Rejection(name, text, None, (Reason(cause, error_code="UOA-227"),))
            for text, cause in function.passed_over
        )
        self._frames.append(frame)

    def _choose(self, frame: _Frame) -> bool:
        rest = frame.agenda
        for candidate in frame.function.components[frame.next_candidate :]:
            self._budget -= 1
            if self._budget < 0:
                raise ResolutionError(
                    "the search was given up: too many combinations were tried",
                    error_code="UOA-203",
                )
            frame.next_candidate += 1
            refusal = self._try(frame, candidate)
            if refusal is None:
                self._assign(frame, candidate, rest)
                return True
            frame.culprits |= refusal.culprits
            frame.rejected.append(_rejection(candidate, refusal.reasons, refusal.because_of))
        return False

    def _try(self, frame: _Frame, candidate: Component) -> _Refusal | None:
        if candidate.name in self._excluded:
            return _Refusal(
                (Reason("it is excluded: it died or was ruled out", error_code="UOA-211"),)
            )
        begun = self._clock()
        structures = self._fit.structures(candidate)
        if not isinstance(structures, Structures):
            self.seconds_unavailable = (self.seconds_unavailable or 0.0) + self._clock() - begun
            return _Refusal((Reason(structures.sentence, error_code="UOA-212"),))
        mistakes = command_mistakes(candidate, structures)
        if mistakes:
            return _Refusal(mistakes)
        frame.structures, frame.edges, frame.warnings = structures, [], list(structures.warnings)
        for depth, consumer, port in self._demands.get(frame.function.name, ()):
            refusal = self._connect(frame, candidate, structures, consumer, port)
            if refusal is not None:
                refusal.culprits.add(depth)
                return refusal
        for port in candidate.inputs:
            if port.source is not None:
                refusal = self._feed(frame, candidate, port)
                if refusal is not None:
                    return refusal
        return None

    def _feed(self, frame: _Frame, candidate: Component, port: Input) -> _Refusal | None:
        """Check an input against its producer where that is chosen already, and for a cycle."""
        assert port.source is not None, "fed by a function"
        name = port.source.function
        if name == frame.function.name:
            return _Refusal(
                (Reason(f"its input {port.name!r} needs its own function", error_code="UOA-214"),)
            )
        if name in self._impossible:
            sentence = f"its input {port.name!r} needs {name!r}, which nothing provides"
            reason = Reason(sentence, error_code="UOA-213")
            return _Refusal((reason,), because_of=self._impossible[name])
        producer = self._assigned.get(name)
        if producer is None:
            return None
        path = self._path_between(producer, frame)
        if path is not None:
            cycle = " -> ".join([*path, name])
            depths = {self._assigned[text].depth for text in path if text in self._assigned}
            return _Refusal(
                (Reason(f"it would close the cycle {cycle}", error_code="UOA-214"),), depths
            )
        assert producer.chosen is not None
        assert producer.structures is not None
        refusal = self._connect(frame, producer.chosen, producer.structures, candidate, port)
        if refusal is not None:
            refusal.culprits.add(producer.depth)
        return refusal

    def _connect(
        self,
        frame: _Frame,
        producer: Component,
        structures: Structures,
        consumer: Component,
        port: Input,
    ) -> _Refusal | None:
        assert port.source is not None, "fed by a function"
        output = producer.output(port.source.port)
        if output is None:
            has = ", ".join(item.name for item in producer.outputs) or "none"
            wanted = port.source.port or "default"
            text = f"{producer.name} has no output {wanted!r} for {consumer.name}; it has {has}"
            return _Refusal((Reason(text, error_code="UOA-215"),))
        given = structures.by_port[f"output.{output.name}"].schema
        if (
            port.endpoint.command is not None
            and isinstance(given, Mapping)
            and given.get(_RECORDED) is True
        ):
            sentence = (
                f"{producer.name} gives what was recorded, and {consumer.name} moves something: "
                "`allow_motion: true` in the options of the recording's bridge lets it"
            )
            return _Refusal((Reason(sentence, error_code="UOA-216"),))
        begun = self._clock()
        made = self._fit.edge(producer, output, structures, consumer, port)
        took = self._clock() - begun
        self._checked += took
        if self._checked > _CHECK_SECONDS:
            edge = f"{producer.name}.{output.name} -> {consumer.name}.{port.name}"
            raise ResolutionError(
                f"the search was given up: checking structures took {self._checked:.0f} s, more "
                f"than {_CHECK_SECONDS:.0f} s; the last, {edge}, {took:.1f} s: "
                "simplify its structures or its map",
                error_code="UOA-203",
            )
        if isinstance(made, Edge):
            frame.edges.append(made)
            frame.warnings.extend(made.warnings)
            frame.warnings.extend(lifetime_warnings(made, output, port))
            return None
        return _Refusal(made)

    def _path_between(self, start: _Frame, goal: _Frame) -> list[str] | None:
        """Return functions from `start` to `goal` along demands, None where there is no way."""
        came: dict[str, str] = {}
        queue = [goal.function.name]
        for name in queue:
            if name == start.function.name:
                path = [name]
                while path[-1] != goal.function.name:
                    path.append(came[path[-1]])
                return path
            for _, consumer, _ in self._demands.get(name, ()):
                if consumer.function not in came and consumer.function != goal.function.name:
                    came[consumer.function] = name
                    queue.append(consumer.function)
        return None

    def _assign(self, frame: _Frame, candidate: Component, rest: _Agenda | None) -> None:
        frame.chosen = candidate
        self._assigned[frame.function.name] = frame
        for port in reversed(candidate.inputs):
            if port.source is not None:
                rest = _Agenda(port.source.function, rest)
        for port in candidate.inputs:
            if port.source is not None:
                demands = self._demands.setdefault(port.source.function, [])
                demands.append((frame.depth, candidate, port))
        frame.agenda = rest

    def _retract(self, frame: _Frame) -> None:
        assert frame.chosen is not None
        del self._assigned[frame.function.name]
        for port in frame.chosen.inputs:
            if port.source is not None:
                self._demands[port.source.function].pop()
                assert frame.agenda is not None
                frame.agenda = frame.agenda.rest
        frame.chosen = None

    def _jump_back(self, frame: _Frame) -> bool:
        """Undo choices back to the latest that had a part in a failure; False: there is none."""
        if frame.introducer is None:
            return False
        rejected = tuple(frame.rejected)
        name = frame.function.name
        if not frame.culprits:
            self._impossible[name] = rejected
        culprits = frame.culprits | {frame.introducer}
        target = max(culprits)
        self._frames.pop()
        while len(self._frames) - 1 > target:
            self._retract(self._frames.pop())
        back = self._frames[target]
        assert back.chosen is not None
        sentence = f"nothing provides {name!r} for it"
        reason = Reason(sentence, error_code="UOA-213")
        back.rejected.append(_rejection(back.chosen, (reason,), rejected))
        back.culprits |= culprits - {target}
        self._retract(back)
        return True

    def _plan(self, name: str) -> Plan:
        steps: list[Step] = []
        edges: list[Edge] = []
        for frame in _producers_first(self._frames, self._assigned):
            assert frame.chosen is not None
            assert frame.structures is not None
            steps.append(Step(frame.chosen, frame.structures.by_port, frame.structures.managers))
        for frame in self._frames:
            edges.extend(frame.edges)
        return Plan(
            function=name,
            steps=tuple(steps),
            edges=tuple(edges),
            rejected=tuple(rejection for frame in self._frames for rejection in frame.rejected),
            warnings=tuple(warning for frame in self._frames for warning in frame.warnings),
        )


def _rejection(
    candidate: Component, reasons: tuple[Reason, ...], because_of: tuple[Rejection, ...]
) -> Rejection:
    priority = candidate.priority if candidate.match is None else None
    return Rejection(candidate.function, candidate.name, priority, reasons, because_of)


def _producers_first(frames: list[_Frame], assigned: Mapping[str, _Frame]) -> list[_Frame]:
    """Order frames so that each stands after all that feed it; the first frame comes last."""
    ordered: list[_Frame] = []
    seen: set[str] = set()
    stack: list[tuple[_Frame, bool]] = [(frames[0], False)]
    while stack:
        frame, expanded = stack.pop()
        if expanded:
            ordered.append(frame)
            continue
        if frame.function.name in seen:
            continue
        seen.add(frame.function.name)
        stack.append((frame, True))
        assert frame.chosen is not None
        stack.extend(
            (assigned[port.source.function], False)
            for port in reversed(frame.chosen.inputs)
            if port.source is not None
        )
    return ordered
