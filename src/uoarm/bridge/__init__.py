"""The bridge contract: what a framework plugin implements and what the manager may rely on."""

from uoarm._backoff import Backoff, TurnCounter, Turns
from uoarm._encodable import shown
from uoarm._forks import at_exit, close_in_children
from uoarm._interrupts import wait_step
from uoarm._origin import install_command
from uoarm._plugins import PluginProblem, hookimpl
from uoarm._raised import LimitedLog, Log, foreign, on_failure, reason_of, text_of
from uoarm._spelling import did_you_mean
from uoarm._support.workers import WorkerExecutor
from uoarm.bridge._border import Delivery, reading_endpoint
from uoarm.bridge._bridge import CONTRACT_VERSION, Bridge
from uoarm.bridge._channel import Channel, NativeLink, Outcomes, ReceiveQueue, Sink, Source
from uoarm.bridge._health import (
    ChannelHealth,
    ChannelMonitor,
    ChannelReport,
    Disconnection,
    HealthReason,
)
from uoarm.bridge._message_check import message_check
from uoarm.bridge._options import (
    BridgeOptions,
    DeclaredOptions,
    EndpointOptions,
    PeerOptions,
    TlsOptions,
    address_check,
    host_of,
    option,
    options_table,
    other_protocol,
    redirection,
    refusal,
    renewed,
    tls_fault,
)
from uoarm.bridge._registry import (
    MOST_HOPS,
    BridgeType,
    Registry,
    asking,
    asking_managers,
    refuse_loop,
)
from uoarm.bridge._services import ServedRequests
from uoarm.bridge._steps import (
    Capabilities,
    Description,
    Discovered,
    Handler,
    HealthEvent,
    ServiceStructures,
)
from uoarm.bridge._watchdog import boot_seconds

__all__ = [
    "CONTRACT_VERSION",
    "MOST_HOPS",
    "Backoff",
    "Bridge",
    "BridgeOptions",
    "BridgeType",
    "Capabilities",
    "Channel",
    "ChannelHealth",
    "ChannelMonitor",
    "ChannelReport",
    "DeclaredOptions",
    "Delivery",
    "Description",
    "Disconnection",
    "Discovered",
    "EndpointOptions",
    "Handler",
    "HealthEvent",
    "HealthReason",
    "LimitedLog",
    "Log",
    "NativeLink",
    "Outcomes",
    "PeerOptions",
    "PluginProblem",
    "ReceiveQueue",
    "Registry",
    "ServedRequests",
    "ServiceStructures",
    "Sink",
    "Source",
    "TlsOptions",
    "TurnCounter",
    "Turns",
    "WorkerExecutor",
    "address_check",
    "asking",
    "asking_managers",
    "at_exit",
    "boot_seconds",
    "close_in_children",
    "did_you_mean",
    "foreign",
    "hookimpl",
    "host_of",
    "install_command",
    "message_check",
    "on_failure",
    "option",
    "options_table",
    "other_protocol",
    "reading_endpoint",
    "reason_of",
    "redirection",
    "refusal",
    "refuse_loop",
    "renewed",
    "shown",
    "text_of",
    "tls_fault",
    "wait_step",
]
