"""What a client asks: a control message checked against the protocol's own schema."""

from __future__ import annotations

import difflib
import json
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from itertools import islice
from typing import TYPE_CHECKING, Any

from uoarm.errors import ControlMessageError
from uoarm.model import ControlMessage, Op, message_octets

if TYPE_CHECKING:
    from jsonschema import Draft202012Validator

__all__ = ["ASKED", "check_asked", "protocol_schema", "salvage_id"]

ASKED = tuple(
    op.value
    for op in (
        Op.REQUEST, Op.KILL, Op.DATA, Op.CALL, Op.LIST, Op.RESOLVE, Op.STATUS, Op.RESUME,
        Op.CONFIGURE, Op.STOP, Op.DISCOVER,
    )
)  # fmt: skip
_OF_ROSBRIDGE = {
    "advertise", "advertise_action", "advertise_service", "call_service", "publish",
    "send_action_goal", "subscribe",
}  # fmt: skip
_QUICK = {"op", "type", "id", "jsonMessage"}
_MAX_ID = 128
_MAX_NAME = 256
_SHOWN = 200
_MOST_REPORTED = 5
# Of a control message without the message in it: the schema check takes its time, and quotes.
_MAX_FIELDS = 64
_MAX_OCTETS = 1_048_576


@cache
def protocol_schema() -> Mapping[str, Any]:
    """Return the JSON Schema of every message, `$defs` named `client.Op` and `server.Op`."""
    text = (files("uoarm._wire") / "protocol.schema.json").read_text(encoding="utf-8")
    schema: Mapping[str, Any] = json.loads(text)
    return schema


def check_asked(fields: Mapping[str, Any]) -> ControlMessage:
    """Return what was asked.

    Raises:
        ControlMessageError: it is not what the schema of its `op` describes; the text names the
            field.
    """
    op = fields.get("op")
    if op not in ASKED:
        raise ControlMessageError(_wrong_op(fields))
    if not (op == "Data" and _is_plain_data(fields)):
        envelope = dict(fields)
        if op in {"Data", "Call"} and "jsonMessage" in envelope:
            envelope["jsonMessage"] = None  # any message is allowed: spare the walk through it
        if len(envelope) > _MAX_FIELDS or message_octets(envelope, most=_MAX_OCTETS) > _MAX_OCTETS:
            allowed = f"{_MAX_FIELDS} fields and {_MAX_OCTETS:,} octets are allowed"
            raise ControlMessageError(f"{op}: too much beside a message: {allowed}")
        reports = [
            ": ".join(
                filter(None, (".".join(map(str, error.absolute_path)), error.message[:_SHOWN]))
            )
            for error in islice(_validator(op).iter_errors(envelope), _MOST_REPORTED)
        ]
        if reports:
            raise ControlMessageError(f"{op}: {'; '.join(reports)}")
    return ControlMessage(
        op=Op(op),
        type=fields.get("type", ""),
        jsonMessage=fields.get("jsonMessage"),
        id=fields["id"],
        extensions={name: field for name, field in fields.items() if name.startswith("x-")},
    )


def salvage_id(fields: Mapping[str, Any]) -> str | None:
    """Return the id of a message that is wrong elsewhere, so that its error finds the asker."""
    identity = fields.get("id")
    return identity if isinstance(identity, str) and 0 < len(identity) <= _MAX_ID else None


def _is_plain_data(fields: Mapping[str, Any]) -> bool:
    """Say quickly whether a Data message is right: they come by the thousand."""
    kind = fields.get("type")
    return (
        fields.keys() == _QUICK
        and isinstance(kind, str)
        and 0 < len(kind) <= _MAX_NAME
        and salvage_id(fields) is not None
    )


def _wrong_op(fields: Mapping[str, Any]) -> str:
    expected = f"expected one of {', '.join(ASKED)}"
    if "op" not in fields:
        return f"op is missing; {expected}"
    op = fields["op"]
    if isinstance(op, str) and op in _OF_ROSBRIDGE:
        return f"op: {op!r} is of rosbridge, whose clients connect at /rosbridge; here {expected}"
    close = difflib.get_close_matches(op[:_SHOWN], ASKED, n=1) if isinstance(op, str) else []
    hint = f"; did you mean {close[0]!r}?" if close else ""
    shown = repr(op[:60]) if isinstance(op, str) else type(op).__name__
    return f"op: {expected}, got {shown}{hint}"


@cache
def _validator(op: str) -> Draft202012Validator:
    from jsonschema import Draft202012Validator  # noqa: PLC0415 - slow import

    return Draft202012Validator({**protocol_schema(), "$ref": f"#/$defs/client.{op}"})
