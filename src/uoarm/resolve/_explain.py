"""Plans and refusals as text that a person can act on."""

from __future__ import annotations

import json

from uoarm.model import Plan, Reason, Rejection

__all__ = ["tell_plan", "tell_rejections"]

_MAX_LINES = 200
_MAX_EXAMPLE = 160


def tell_plan(plan: Plan) -> str:
    """Return a plan as text: what will run, how it is connected, what was passed over."""
    lines = [f"plan for {plan.function}"]
    for number, step in enumerate(plan.steps, 1):
        one = step.component
        lines.append(
            f"  {number}. {one.function}: {one.name} ({one.bridge}, priority {one.priority})"
        )
    if plan.edges:
        lines.append("connections, all proven to fit")
    for edge in plan.edges:
        how = " through a map" if edge.mapping is not None else ""
        lines.append(f"  {edge.producer}.{edge.output} -> {edge.consumer}.{edge.input}{how}")
        lines.extend(f"      allowed loss: {loss}" for loss in edge.losses)
    if plan.rejected:
        lines.append("passed over")
        lines.append(tell_rejections(plan.rejected))
    lines.extend(f"note: {warning}" for warning in plan.warnings)
    return "\n".join(lines)


def tell_rejections(rejections: tuple[Rejection, ...]) -> str:
    """Return rejected candidates as an indented tree, cut at 200 lines."""
    lines: list[str] = []
    stack = [(rejection, 1) for rejection in reversed(rejections)]
    while stack and len(lines) < _MAX_LINES:
        rejection, depth = stack.pop()
        indent = "  " * depth
        lines.append(
            f"{indent}{rejection.function}: {rejection.component} (priority {rejection.priority})"
        )
        for reason in rejection.reasons:
            lines.extend(f"{indent}  {line}" for line in _tell_reason(reason))
        stack.extend((one, depth + 2) for one in reversed(rejection.because_of))
    if stack:
        lines.append(f"  ... and {len(stack)} more")
    return "\n".join(lines) or "  it has no candidates"


def _tell_reason(reason: Reason) -> list[str]:
    where = f"{reason.path}: " if reason.path else ""
    lines = [f"- {where}{reason.sentence}"]
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
