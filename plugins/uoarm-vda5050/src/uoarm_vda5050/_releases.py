"""What differs between the releases of VDA 5050: names, numbers, words."""

from __future__ import annotations

from attrs import frozen

__all__ = ["RELEASES", "SENT", "TOPICS", "ErrorTypes", "VdaRelease"]

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
