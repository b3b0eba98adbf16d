"""What differs between the releases of VDA 5050: names, numbers, words; and their structures.

The structures are written for this plugin: what the standard requires and what is used. What the
published JSON Schemas allow to vehicles fits them; a user who has those names their folder
(`_messages.py`). What is not named here is tolerated and passes.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

from attrs import frozen

from uoarm.model import MessageStructure

TOPICS = ("order", "instantActions", "state", "visualization", "connection", "factsheet")
SENT = ("order", "instantActions")
"""Topics of messages to a vehicle; the others are of messages by it."""


@frozen
class ErrorTypes:
    """Names of the errors by which a vehicle refuses something.

    Attributes:
        malformed: an order that cannot be read.
        action: an order with an action that the vehicle cannot perform.
        busy: a new order while another one is under way.
        start: a new order whose first node is not where the vehicle is.
        outdated: an update with a lower `orderUpdateId`.
        differs: the same order and update with another content; empty: ignored.
        cancelled: an update of an order that was cancelled.
        gap: an update that does not begin where the order ends.
        mode: an order in an operating mode that takes none.
        nothing: `cancelOrder` without an order.
        instant: an instant action that the vehicle does not know.
        more: other refusals of orders that vehicles may report.
    """

    malformed: str
    action: str
    busy: str
    start: str
    outdated: str
    differs: str
    cancelled: str
    gap: str
    mode: str
    nothing: str
    instant: str
    more: frozenset[str]

    @property
    def refusals(self) -> frozenset[str]:
        """Every error type by which an order or an update is refused."""
        named = {self.malformed, self.action, self.busy, self.start, self.outdated}
        return self.more | named | {self.differs, self.cancelled, self.gap, self.mode} - {""}


@frozen
class VdaRelease:
    """One release of the standard.

    Attributes:
        name: by which a configuration names it.
        version: that headers state.
        interface: the first level of topics that it suggests.
        broken: the connection state of the last will.
        position: member of a state with the position.
        localized: member of the position: whether the vehicle knows where it is.
        battery: member of a state with the battery, and its member with the charge in percent.
        speed: member of an edge with the highest speed.
        emergency: member of `safetyState`.
        instant_states: member of a state with the states of instant actions.
        instant_blocking: the blocking type that instant actions carry.
        remark: what a member with a description of something ends with.
        is_elliptic: whether the deviation of a position is an ellipse and no radius.
        also_named: second names of `actions` and `actionType` in instant actions; none: empty.
        errors: names of errors.
    """

    name: str
    version: str
    interface: str
    broken: str
    position: str
    localized: str
    battery: tuple[str, str]
    speed: str
    emergency: str
    instant_states: str
    instant_blocking: str
    remark: str
    is_elliptic: bool
    also_named: tuple[str, ...]
    errors: ErrorTypes

    @property
    def major(self) -> str:
        """The number before the first point of the version."""
        return self.version.partition(".")[0]

    def prefix(self, interface: str = "") -> str:
        """Return the first two levels of every topic."""
        return f"{interface or self.interface}/v{self.major}"


_ERRORS_2 = ErrorTypes(
    malformed="validationError",
    action="orderError",
    busy="orderError",
    start="noRouteError",
    outdated="orderUpdateError",
    differs="",
    cancelled="orderUpdateError",
    gap="orderUpdateError",
    mode="orderError",
    nothing="noOrderToCancel",
    instant="instantActionError",
    more=frozenset({"orderValidationError", "orderCreationError"}),
)
_ERRORS_3 = ErrorTypes(
    malformed="VALIDATION_FAILURE",
    action="INVALID_ORDER_ACTION",
    busy="OTHER_ORDER_ACTIVE",
    start="START_NODE_OUT_OF_RANGE",
    outdated="OUTDATED_ORDER_UPDATE",
    differs="SAME_ORDER_UPDATE_ID",
    cancelled="ORDER_UPDATE_FOLLOWING_CANCEL",
    gap="VALIDATION_FAILURE",
    mode="MOBILE_ROBOT_NOT_AVAILABLE",
    nothing="NO_ORDER_TO_CANCEL",
    instant="INVALID_INSTANT_ACTION",
    more=frozenset(
        {"UNSUPPORTED_PARAMETER", "INSUFFICIENT_MEMORY", "NO_ROUTE_TO_TARGET", "UNKNOWN_MAP_ID"}
    ),
)


def _second(minor: int, *also_named: str) -> VdaRelease:
    return VdaRelease(
        name=f"2.{minor}",
        version=f"2.{minor}.0",
        interface="uagv",
        broken="CONNECTIONBROKEN",
        position="agvPosition",
        localized="positionInitialized",
        battery=("batteryState", "batteryCharge"),
        speed="maxSpeed",
        emergency="eStop",
        instant_states="actionStates",
        instant_blocking="HARD",
        remark="Description",
        is_elliptic=False,
        also_named=also_named,
        errors=_ERRORS_2,
    )


_THIRD = VdaRelease(
    name="3.0",
    version="3.0.0",
    interface="vda5050",
    broken="CONNECTION_BROKEN",
    position="mobileRobotPosition",
    localized="localized",
    battery=("powerSupply", "stateOfCharge"),
    speed="maximumSpeed",
    emergency="activeEmergencyStop",
    instant_states="instantActionStates",
    instant_blocking="NONE",
    remark="Descriptor",
    is_elliptic=True,
    also_named=(),
    errors=_ERRORS_3,
)

# The document of 2.0.0 has instant actions as `actions` with an `actionType`; its published schema
# says `actionName`, and there are vehicles that read `instantActions`: they are sent all of it.
_NAMES = ("instantActions", "actionName")
RELEASES = {release.name: release for release in (_second(0, *_NAMES), _second(1), _THIRD)}


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
    action = _action(release)
    if not release.also_named:
        return _object({"actions": _list(action)})
    whole, name = release.also_named  # which of the two names each has is not certain
    required = [item for item in action["required"] if item != "actionType"]
    action = {**action, "properties": {**action["properties"], name: _TEXT}, "required": required}
    return _object({}, {"actions": _list(action), whole: _list(action)})


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
