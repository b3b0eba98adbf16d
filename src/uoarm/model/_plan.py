"""The immutable result of resolving one request, and its text that a person can act on."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cached_property

from attrs import field, frozen

from uoarm.model._component import Component
from uoarm.model._message import MessageStructure, exact

_MAX_LINES = 200
_MAX_EXAMPLE = 160
_MAX_PATHS = 8


@frozen
class Reason:
    """One cause of a refusal.

    Attributes:
        sentence: what is wrong, in one sentence.
        path: field path within the message, empty for the whole.
        producer: what the producing side may emit there.
        consumer: what the consuming side takes there.
        example: the smallest part of a message that shows it.
        suggestion: configuration lines that would mend it, ready to paste.
        error_code: of `uoarm.error_codes`.
    """

    sentence: str
    path: str = ""
    producer: str = ""
    consumer: str = ""
    example: object = field(default=None, hash=False)
    suggestion: str = ""
    error_code: str = "UOA-220"


@frozen
class Rejection:
    """A candidate that was tried and not taken, with every reason.

    `because_of` lists the rejected candidates of the functions that it depends on; `priority` is
    None where the component was discovered and not named.
    """

    function: str
    component: str
    priority: int | None
    reasons: tuple[Reason, ...]
    because_of: tuple[Rejection, ...] = ()


@frozen
class Edge:
    """A checked connection from one component's output to another's input.

    `unstated` has the paths of numbers and octets that fit in shape and of whose meaning one side
    says nothing; `strict` says that there may be none.
    """

    producer: str
    output: str
    consumer: str
    input: str
    producer_structure: MessageStructure
    consumer_structure: MessageStructure
    mapping: Mapping[str, object] | None = field(default=None, eq=exact, hash=False)
    losses: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    unstated: tuple[str, ...] = ()
    strict: bool = False


@frozen
class Step:
    """One chosen component with the structures of its ports.

    They are keyed `input.NAME` and `output.NAME`; a service has `request` and `reply`. `managers`
    are the identities of the other managers through which its messages pass, the nearest first.
    """

    component: Component
    structures: Mapping[str, MessageStructure] = field(hash=False)
    managers: tuple[str, ...] = ()


# With slots, attrs gives it a `__getattr__` that `help` of CPython 3.13 cannot show.
@frozen(repr=False, slots=False)
class Plan:
    """What will be opened for one request: steps, producers first, and the edges between.

    As text (`str`, `print`) it is what `uoarm resolve --explain` shows.

    Attributes:
        function: the function asked for; provided by the last step.
        steps: chosen components; each stands after all that it depends on.
        edges: connections between steps; `Edge.producer` and `.consumer` name components.
        rejected: candidates of higher priority that were passed over, with their reasons.
        warnings: what a careful reader should know, none of which stops the plan.
    """

    function: str
    steps: tuple[Step, ...]
    edges: tuple[Edge, ...] = ()
    rejected: tuple[Rejection, ...] = ()
    warnings: tuple[str, ...] = ()

    @cached_property
    def provider(self) -> Step:
        """The step whose component provides the function asked for."""
        return self.steps[-1]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of its components, producers first."""
        return tuple(step.component.name for step in self.steps)

    @property
    def managers(self) -> tuple[str, ...]:
        """Identities of the other managers through which its messages pass."""
        return tuple(dict.fromkeys(name for step in self.steps for name in step.managers))

    def __str__(self) -> str:
        lines = [f"plan for {self.function}"]
        for number, step in enumerate(self.steps, 1):
            provider = step.component
            found = provider.match
            how = f"priority {provider.priority}" if found is None else f"discovered: {found.why}"
            lines.append(
                f"  {number}. {provider.function}: {provider.name} ({provider.bridge}, {how})"
            )
            if step.managers:
                lines.append(f"      through other managers: {', then '.join(step.managers)}")
        if self.edges:
            lines.append("connections, all proven to fit")
        for edge in self.edges:
            how = " through a map" if edge.mapping is not None else ""
            lines.append(f"  {edge.producer}.{edge.output} -> {edge.consumer}.{edge.input}{how}")
            lines.extend(f"      allowed loss: {loss}" for loss in edge.losses)
            if edge.strict:
                lines.append("      strict: both sides state what every number means")
            if edge.unstated:
                shown = [name or "the whole message" for name in edge.unstated[:_MAX_PATHS]]
                more = len(edge.unstated) - len(shown)
                rest = f" and {more} more" if more else ""
                lines.append(f"      rests on shape alone: {', '.join(shown)}{rest}")
        if self.rejected:
            lines.append("passed over")
            lines.append(format_rejections(self.rejected))
        lines.extend(f"note: {warning}" for warning in self.warnings)
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"<Plan {self.function}: {' -> '.join(self.names)}>"


def format_rejections(rejections: tuple[Rejection, ...]) -> str:
    """Return rejected candidates as an indented tree, cut at 200 lines."""
    lines: list[str] = []
    stack = [(rejection, 1) for rejection in reversed(rejections)]
    while stack and len(lines) < _MAX_LINES:
        rejection, depth = stack.pop()
        indent = "  " * depth
        rank = rejection.priority
        how = "discovered" if rank is None else f"priority {rank}"
        lines.append(f"{indent}{rejection.function}: {rejection.component} ({how})")
        for reason in rejection.reasons:
            lines.extend(f"{indent}  {line}" for line in format_reason(reason))
        stack.extend((item, depth + 2) for item in reversed(rejection.because_of))
    if stack:
        lines.append(f"  ... and {len(stack)} more")
    return "\n".join(lines) or "  it has no candidates"


def format_reason(reason: Reason) -> list[str]:
    """Return one reason as lines of text, with what would mend it."""
    where = f"{reason.path}: " if reason.path else ""
    head, *more = reason.sentence.splitlines() or [""]  # another manager's has its own tree
    lines = [f"- {where}{head}", *(f"  {line}" for line in more)]
    if reason.producer:
        lines.append(f"    may emit: {reason.producer}")
    if reason.consumer:
        lines.append(f"    takes:    {reason.consumer}")
    if reason.example is not None:
        text = json.dumps(reason.example, default=str)
        lines.append(f"    example:  {text[:_MAX_EXAMPLE]}")
    if reason.suggestion:
        lines.append("    it would fit with:")
        lines.extend(f"      {line}" for line in reason.suggestion.splitlines())
    return lines
