"""What is written of a value field by field: a new field fails until it is written or left out."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

import attrs
import pytest

from uoarm import _figures
from uoarm._lock._record import _edge
from uoarm.local import status
from uoarm.model import (
    BridgeStatus,
    ComponentStatus,
    ConnectionStatus,
    Edge,
    MachineStatus,
    OfferStatus,
    RouteStatus,
    StatusMap,
)
from uoarm.schema import Verdict
from uoarm.server.access._approvals import Approval, ApprovalRequest, Approvals
from uoarm.server.session._views import show_approval

# What several functions write together.
_SHOWN = (show_approval, Approval.facts)
_AUDITED = (Approvals._report, Approval.facts)
WRITTEN: tuple[tuple[type, Callable[..., Any] | Any, dict[str, str]], ...] = (
    (
        Approval,
        _SHOWN,
        {"expires": "`left` says how long it is valid still", "used": "`uses` says how often"},
    ),
    (ApprovalRequest, _SHOWN, {}),
    (
        Approval,
        _AUDITED,
        {"expires": "a phase of its own says that it has", "used": "`uses` says how often"},
    ),
    (
        ApprovalRequest,
        _AUDITED,
        {
            "foundation": "the phase says when it has changed",
            "preview": "for who decides; it says what the other fields say",
        },
    ),
    (ComponentStatus, status, {"channels": "of links, not of health"}),
    (ConnectionStatus, status, {}),
    (BridgeStatus, status, {"assigned": "of the configuration, not of health"}),
    (
        RouteStatus,
        status,
        {"copies": "of speed, not of health", "refusal": "stands in the cause of its component"},
    ),
    (
        Edge,
        _edge,
        {
            **dict.fromkeys(("producer_structure", "consumer_structure"), "locked by their ports"),
            **dict.fromkeys(("losses", "warnings"), "follow from what is locked"),
            "strict": "follows from the configuration, which is compared by itself",
        },
    ),
    (StatusMap, _figures, {}),
    (
        RouteStatus,
        _figures,
        {
            **dict.fromkeys(("rate", "age"), "follow from how its counters grow"),
            **dict.fromkeys(("last_error", "refusal"), "texts are not figures"),
            "native": "nothing of it is counted",
        },
    ),
    (
        OfferStatus,
        _figures,
        {
            **dict.fromkeys(("cause", "endpoints"), "texts are not figures"),
            "bridge": "stands in its name",
            "connections": "their flows have figures of their own",
        },
    ),
    (
        MachineStatus,
        _figures,
        {
            "bridges": "have figures of their own",
            "clock_error": "of the measurement, not of the machine",
            "cause": "texts are not figures",
        },
    ),
    (Verdict, Verdict.to_dict, {"_message": "`counterexample` is what it says"}),
)


def is_written(source: str, name: str) -> bool:
    return f".{name}" in source


def _name(value: Any) -> str:
    return str(getattr(value, "__qualname__", None) or getattr(value, "__name__", ""))


@pytest.mark.parametrize(
    ("kind", "writes", "left_out"),
    WRITTEN,
    ids=lambda value: " and ".join(map(_name, value if isinstance(value, tuple) else (value,))),
)
def test_each_field_is_written_or_left_out_for_a_reason(
    kind: Any, writes: Any, left_out: dict[str, str]
) -> None:
    together = writes if isinstance(writes, tuple) else (writes,)
    source = "".join(map(inspect.getsource, together))
    names = {attribute.name for attribute in attrs.fields(kind)}
    forgotten = {name for name in names - left_out.keys() if not is_written(source, name)}
    text = f"write these in {_name(together[0])}, or list why they are left out"
    assert not forgotten, f"{kind.__name__}: {text}: {sorted(forgotten)}"
    assert left_out.keys() <= names, f"{kind.__name__} has no such field any more"


def test_a_field_that_is_forgotten_is_found() -> None:
    further: Any = attrs.make_class(
        "Further", {"fresh": attrs.field(default=0)}, bases=(Edge,), frozen=True
    )
    left_out = next(reasons for kind, _, reasons in WRITTEN if kind is Edge)
    with pytest.raises(AssertionError, match="'fresh'"):
        test_each_field_is_written_or_left_out_for_a_reason(further, _edge, left_out)
