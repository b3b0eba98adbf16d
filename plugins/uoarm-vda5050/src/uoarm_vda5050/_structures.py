"""Structures of the topics, written for this plugin: what the standard requires and what is used.

What the published JSON Schemas allow to vehicles fits them; a user who has those names their folder
(`_messages.py`). What is not named here is tolerated and passes.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from uoarm.model import MessageStructure
from uoarm_vda5050._releases import RELEASES, VdaRelease

__all__ = ["HEADER", "TRANSPORT_PARTS", "body_of", "transport_structure", "with_header"]

_Schema = dict[str, Any]

TRANSPORT_PARTS = ("goal", "cancel", "status", "feedback", "result")
_STATES = ["accepted", "rejected", "succeeded", "canceled", "aborted", "lost"]

_TEXT: _Schema = {"type": "string"}
_YES: _Schema = {"type": "boolean"}
_COUNT: _Schema = {"type": "integer"}
_NUMBER: _Schema = {"type": "number"}
_METRES: _Schema = {"type": "number", "x-unit": "m"}
_RADIANS: _Schema = {"type": "number", "x-unit": "rad"}
_SPEED: _Schema = {"type": "number", "x-unit": "m/s"}
_KILOGRAMS: _Schema = {"type": "number", "x-unit": "kg"}
_PERCENT: _Schema = {"type": "number", "x-unit": "%"}
_VALUE: _Schema = {"type": ["array", "boolean", "number", "string", "object"]}


def _object(required: Mapping[str, Any], optional: Mapping[str, Any] | None = None) -> _Schema:
    properties = {**required, **(optional or {})}
    return {"type": "object", "properties": properties, "required": list(required)}


def _list(items: _Schema, **more: Any) -> _Schema:
    return {"type": "array", "items": items, **more}


def _words(*words: str) -> _Schema:
    return {"type": "string", "enum": list(words)}


HEADER: Mapping[str, _Schema] = {
    "headerId": _COUNT,
    "timestamp": _TEXT,
    "version": _TEXT,
    "manufacturer": _TEXT,
    "serialNumber": _TEXT,
}

_REFERENCE = _object({"referenceKey": _TEXT, "referenceValue": _TEXT})
_PARAMETER = _object({"key": _TEXT, "value": _VALUE})
_VELOCITY = _object(
    {}, {"vx": _SPEED, "vy": _SPEED, "omega": {"type": "number", "x-unit": "rad/s"}}
)
_LOAD = _object(
    {}, {"loadId": _TEXT, "loadType": _TEXT, "loadPosition": _TEXT, "weight": _KILOGRAMS}
)


def with_header(body: MessageStructure) -> MessageStructure:
    """Return the structure of messages with the fields of the header."""
    schema: Any = body.schema
    both = {
        **schema,
        "properties": {**HEADER, **schema.get("properties", {})},
        "required": [*HEADER, *schema.get("required", ())],
    }
    return MessageStructure(both, native_type=body.native_type)


@cache
def body_of(topic: str, release: str) -> MessageStructure:
    """Return the structure of a topic's messages without their header."""
    made = _BODIES[topic](RELEASES[release])
    return MessageStructure(made, native_type=f"vda5050/{topic}/{release}")


def _action(release: VdaRelease) -> _Schema:
    blocking = (
        ("NONE", "SOFT", "HARD") if release.major == "2" else ("NONE", "SOFT", "SINGLE", "HARD")
    )
    return _object(
        {"actionType": _TEXT, "actionId": _TEXT, "blockingType": _words(*blocking)},
        {f"action{release.remark}": _TEXT, "actionParameters": _list(_PARAMETER)},
    )


def _order(release: VdaRelease) -> _Schema:
    actions = _list(_action(release))
    ellipse = _object({"a": _METRES, "b": _METRES, "theta": _RADIANS})
    position = _object(
        {"x": _METRES, "y": _METRES, "mapId": _TEXT},
        {
            "theta": _RADIANS,
            "allowedDeviationXY": ellipse if release.is_elliptic else {**_METRES, "minimum": 0},
            "allowedDeviationTheta": _RADIANS,
        },
    )
    node = _object(
        {"nodeId": _TEXT, "sequenceId": _COUNT, "released": _YES, "actions": actions},
        {"nodePosition": position, f"node{release.remark}": _TEXT},
    )
    edge = _object(
        {
            "edgeId": _TEXT,
            "sequenceId": _COUNT,
            "released": _YES,
            "actions": actions,
            **({} if release.major != "2" else {"startNodeId": _TEXT, "endNodeId": _TEXT}),
        },
        {release.speed: _SPEED, f"edge{release.remark}": _TEXT},
    )
    return _object(
        {
            "orderId": _TEXT,
            "orderUpdateId": _COUNT,
            "nodes": _list(node, minItems=1),
            "edges": _list(edge),
        }
    )


def _instant_actions(release: VdaRelease) -> _Schema:
    actions = _list(_action(release))
    if release.also_named:  # which of the two names it has is not certain
        return _object({}, {"actions": actions, release.also_named[0]: actions})
    return _object({"actions": actions})


def _action_state(release: VdaRelease) -> _Schema:
    result = "resultDescription" if release.major == "2" else "actionResult"
    words = ["WAITING", "INITIALIZING", "RUNNING", "PAUSED", "FINISHED", "FAILED"]
    words += [] if release.major == "2" else ["RETRIABLE"]
    return _object(
        {"actionId": _TEXT, "actionStatus": _words(*words)},
        {"actionType": _TEXT, result: _TEXT, f"action{release.remark}": _TEXT},
    )


def _position(release: VdaRelease) -> _Schema:
    return _object(
        {"x": _METRES, "y": _METRES, "theta": _RADIANS, "mapId": _TEXT, release.localized: _YES},
        {"localizationScore": _NUMBER, "deviationRange": _METRES},
    )


def _error(release: VdaRelease) -> _Schema:
    more = () if release.major == "2" else ("URGENT", "CRITICAL")
    return _object(
        {"errorType": _TEXT, "errorLevel": _words("WARNING", *more, "FATAL")},
        {"errorDescription": _TEXT, "errorReferences": _list(_REFERENCE)},
    )


def _state(release: VdaRelease) -> _Schema:
    node = _object(
        {"nodeId": _TEXT, "sequenceId": _COUNT, "released": _YES},
        {
            "nodePosition": _object(
                {"x": _METRES, "y": _METRES, "mapId": _TEXT}, {"theta": _RADIANS}
            )
        },
    )
    edge = _object({"edgeId": _TEXT, "sequenceId": _COUNT, "released": _YES})
    second, charge = release.battery
    modes = ("AUTOMATIC", "SEMIAUTOMATIC", "MANUAL", "SERVICE")
    mode = ("TEACHIN",) if release.major == "2" else ("TEACH_IN", "STARTUP", "INTERVENED")
    stops = ("AUTOACK",) if release.major == "2" else ()
    states = _list(_action_state(release))
    return _object(
        {
            "orderId": _TEXT,
            "orderUpdateId": _COUNT,
            "lastNodeId": _TEXT,
            "lastNodeSequenceId": _COUNT,
            "nodeStates": _list(node),
            "edgeStates": _list(edge),
            "driving": _YES,
            "actionStates": states,
            release.instant_states: states,
            second: _object({charge: _PERCENT, "charging": _YES}, {"batteryVoltage": _NUMBER}),
            "operatingMode": _words(*modes, *mode),
            "errors": _list(_error(release)),
            "safetyState": _object(
                {
                    release.emergency: _words(*stops, "MANUAL", "REMOTE", "NONE"),
                    "fieldViolation": _YES,
                }
            ),
        },
        {
            "paused": _YES,
            "newBaseRequest": _YES,
            "distanceSinceLastNode": _METRES,
            release.position: _position(release),
            "velocity": _VELOCITY,
            "loads": _list(_LOAD),
        },
    )


def _visualization(release: VdaRelease) -> _Schema:
    return _object({}, {release.position: _position(release), "velocity": _VELOCITY})


def _connection(release: VdaRelease) -> _Schema:
    more = () if release.major == "2" else ("HIBERNATING",)
    return _object({"connectionState": _words("ONLINE", "OFFLINE", release.broken, *more)})


def _factsheet(release: VdaRelease) -> _Schema:
    mass = "maxLoadMass" if release.major == "2" else "maximumLoadMass"
    anything = {"type": "object"}
    return _object(
        {
            "typeSpecification": _object({"seriesName": _TEXT, mass: _KILOGRAMS}),
            "physicalParameters": anything,
            "protocolLimits": anything,
            "protocolFeatures": anything,
        },
        {"loadSpecification": anything},
    )


_BODIES = {
    "order": _order,
    "instantActions": _instant_actions,
    "state": _state,
    "visualization": _visualization,
    "connection": _connection,
    "factsheet": _factsheet,
}

# A transport order is the same for every release, in the names of 2.1.
_GOAL_ACTION = _object(
    {"actionType": _TEXT},
    {
        "actionId": _TEXT,
        "blockingType": _words("NONE", "SOFT", "HARD"),
        "actionParameters": _list(_PARAMETER),
    },
)
_GOAL = _object(
    {
        "nodes": _list(
            _object(
                {"nodeId": _TEXT},
                {
                    "nodePosition": _object(
                        {"x": _METRES, "y": _METRES, "mapId": _TEXT},
                        {
                            "theta": _RADIANS,
                            "allowedDeviationXY": {**_METRES, "minimum": 0},
                            "allowedDeviationTheta": {**_RADIANS, "minimum": 0},
                        },
                    ),
                    "released": _YES,
                    "actions": _list(_GOAL_ACTION),
                },
            ),
            minItems=1,
        )
    },
    {
        "orderId": {"type": "string", "minLength": 1},
        "edges": _list(
            _object({}, {"edgeId": _TEXT, "maxSpeed": _SPEED, "actions": _list(_GOAL_ACTION)})
        ),
    },
)
_ACTIONS = _list(_object({"actionId": _TEXT, "actionStatus": _TEXT}, {"actionType": _TEXT}))
_ERRORS = _list(_object({"errorType": _TEXT, "errorLevel": _TEXT}, {"errorDescription": _TEXT}))
_FEEDBACK = _object(
    {
        "orderId": _TEXT,
        "orderUpdateId": _COUNT,
        "lastNodeId": _TEXT,
        "lastNodeSequenceId": _COUNT,
        "driving": _YES,
        "paused": _YES,
        "remaining": _COUNT,
        "loads": _list(_LOAD),
        "actions": _ACTIONS,
        "errors": _ERRORS,
    },
    {
        "position": _object(
            {"x": _METRES, "y": _METRES, "theta": _RADIANS, "mapId": _TEXT, "localized": _YES}
        ),
        "batteryCharge": _PERCENT,
    },
)
_RESULT = _object(
    {"orderId": _TEXT, "lastNodeId": _TEXT, "reason": _TEXT, "actions": _ACTIONS, "errors": _ERRORS}
)
_ID = {"goal_id": _TEXT}
_STATUS = _words(*_STATES)
_PARTS = {
    "goal": _GOAL,
    "cancel": _object(_ID),
    "status": _object({**_ID, "status": _STATUS}),
    "feedback": _object({**_ID, "feedback": _FEEDBACK}),
    "result": _object({**_ID, "status": _STATUS, "result": _RESULT}),
    "reply": _RESULT,
}


@cache
def transport_structure(part: str) -> MessageStructure:
    """Return the structure of a part of a transport order; `reply` is that of a call."""
    return MessageStructure(_PARTS[part], native_type=f"vda5050/transport.{part}")
