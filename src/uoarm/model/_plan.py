"""The immutable result of resolving one request."""

from __future__ import annotations

from collections.abc import Mapping

from attrs import field, frozen

from uoarm.model._component import Component
from uoarm.model._explain import tell_plan
from uoarm.model._structure import MessageStructure

__all__ = ["Edge", "Plan", "Reason", "Rejection", "Step"]


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
    """

    sentence: str
    path: str = ""
    producer: str = ""
    consumer: str = ""
    example: object = field(default=None, hash=False)
    suggestion: str = ""


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
    mapping: Mapping[str, object] | None = field(default=None, hash=False)
    losses: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    unstated: tuple[str, ...] = ()
    strict: bool = False


@frozen
class Step:
    """One chosen component with the structures of its ports.

    They are keyed `input.NAME` and `output.NAME`; a service has `request` and `reply`.
    """

    component: Component
    structures: Mapping[str, MessageStructure] = field(hash=False)


@frozen(repr=False)
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

    @property
    def provider(self) -> Step:
        """The step whose component provides the function asked for."""
        return self.steps[-1]

    def __str__(self) -> str:
        return tell_plan(self)

    def __repr__(self) -> str:
        return f"<Plan {self.function}: {' -> '.join(one.component.name for one in self.steps)}>"
