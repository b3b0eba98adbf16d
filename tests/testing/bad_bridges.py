"""Deliberate bugs in a memory bridge, each with the rule of the conformance kit that catches it."""

from __future__ import annotations

from tests.testing.bad_descriptions import DESCRIPTION_BUGS, OPTION_BUGS, SERVICE_BUGS
from tests.testing.bad_endings import BLOCKING_BUGS, CLOSING_BUGS, HEALTH_BUGS, LINK_BUGS
from tests.testing.bad_messages import ERROR_BUGS, MESSAGE_BUGS, WAITING_BUGS
from tests.testing.bad_moments import MOMENT_BUGS
from tests.testing.bad_services import BROKEN_BUGS
from tests.testing.bad_worlds import Bug

from uoarm.testing.conformance._world import rule_of

BUGS: tuple[Bug, ...] = (
    *MESSAGE_BUGS,
    *ERROR_BUGS,
    *DESCRIPTION_BUGS,
    *CLOSING_BUGS,
    *BLOCKING_BUGS,
    *HEALTH_BUGS,
    *LINK_BUGS,
    *OPTION_BUGS,
    *SERVICE_BUGS,
    *WAITING_BUGS,
    *MOMENT_BUGS,
    *BROKEN_BUGS,
)
"""What a careful engineer gets wrong, and the kit finds."""


def table() -> str:
    """Return the table of the page: bug, the rule that catches it, what the test says."""
    rows = [f"| {bug.kind} | {bug.name} | {rule_of(bug.caught)} | `{bug.says}` |" for bug in BUGS]
    head = "| class | the bridge | the rule that catches it | the test says |"
    return "\n".join([head, "|---|---|---|---|", *rows])
