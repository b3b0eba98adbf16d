"""Frozen values that every layer shares. They hold facts and do nothing."""

from uoarm.model._availability import Availability, FunctionStatus
from uoarm.model._budget import Budget, Spending
from uoarm.model._change import ConfigurationChange, ConnectionEffect, Effect
from uoarm.model._command import (
    CommandPhase,
    CommandPolicy,
    CommandStatus,
    FieldLimit,
    LeaseHolder,
    LeasePolicy,
    LeaseStatus,
    StopMessage,
    StopOutcome,
    StopReport,
)
from uoarm.model._component import (
    Component,
    Endpoint,
    Expectation,
    Function,
    Input,
    Match,
    Meaning,
    MeaningLevel,
    Need,
    Output,
    PortRef,
    Role,
    Service,
)
from uoarm.model._control import ControlMessage, Op
from uoarm.model._control_wire import read_control, write_control
from uoarm.model._discovery import BridgeFindings, FoundComponent, FoundPort
from uoarm.model._json import finite, read_json, write_json
from uoarm.model._json_scan import scan_json
from uoarm.model._listening import Listening, place_problem
from uoarm.model._octets import message_octets
from uoarm.model._offer import Offer, OfferedPort, OfferedService, OfferState, OfferStatus
from uoarm.model._plan import (
    Edge,
    Plan,
    Reason,
    Rejection,
    Step,
    tell_reason,
    tell_rejections,
)
from uoarm.model._queue import OverflowPolicy, QueuePolicy, ValidationMode
from uoarm.model._robot import BridgeSpec, FailoverPolicy, FailureLimits, LockMode, Robot
from uoarm.model._show import show_value
from uoarm.model._status import (
    BridgeStatus,
    ChannelStatus,
    ComponentStatus,
    ConnectionState,
    ConnectionStatus,
    Gap,
    Health,
    LockDifference,
    MachineStatus,
    RouteStatus,
    StatusEvent,
    StatusMap,
)
from uoarm.model._status_text import tell_status, tell_trouble
from uoarm.model._structure import MessageStructure
from uoarm.model._values import Deliver, Message, Options, Schema
from uoarm.model._wire import from_json, to_json

__all__ = [
    "Availability",
    "BridgeFindings",
    "BridgeSpec",
    "BridgeStatus",
    "Budget",
    "ChannelStatus",
    "CommandPhase",
    "CommandPolicy",
    "CommandStatus",
    "Component",
    "ComponentStatus",
    "ConfigurationChange",
    "ConnectionEffect",
    "ConnectionState",
    "ConnectionStatus",
    "ControlMessage",
    "Deliver",
    "Edge",
    "Effect",
    "Endpoint",
    "Expectation",
    "FailoverPolicy",
    "FailureLimits",
    "FieldLimit",
    "FoundComponent",
    "FoundPort",
    "Function",
    "FunctionStatus",
    "Gap",
    "Health",
    "Input",
    "LeaseHolder",
    "LeasePolicy",
    "LeaseStatus",
    "Listening",
    "LockDifference",
    "LockMode",
    "MachineStatus",
    "Match",
    "Meaning",
    "MeaningLevel",
    "Message",
    "MessageStructure",
    "Need",
    "Offer",
    "OfferState",
    "OfferStatus",
    "OfferedPort",
    "OfferedService",
    "Op",
    "Options",
    "Output",
    "OverflowPolicy",
    "Plan",
    "PortRef",
    "QueuePolicy",
    "Reason",
    "Rejection",
    "Robot",
    "Role",
    "RouteStatus",
    "Schema",
    "Service",
    "Spending",
    "StatusEvent",
    "StatusMap",
    "Step",
    "StopMessage",
    "StopOutcome",
    "StopReport",
    "ValidationMode",
    "finite",
    "from_json",
    "message_octets",
    "place_problem",
    "read_control",
    "read_json",
    "scan_json",
    "show_value",
    "tell_reason",
    "tell_rejections",
    "tell_status",
    "tell_trouble",
    "to_json",
    "write_control",
    "write_json",
]
