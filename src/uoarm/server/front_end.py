"""The contract of front ends: what serves another protocol on the same robot.

Most speak over WebSocket; one may bring HTTP of its own (`FrontEnd.serve`).

A front end gets the manager, the forms of messages, the rights of each client and the limits that
hold for it. The server does the rest: TLS, tokens, origins, bounds of connections and rates, pings,
and the writing of what waits. Everything here is called in the thread of the server's loop, and
must not wait, unless it says otherwise.
"""

from __future__ import annotations

import socket
import ssl
from collections.abc import Awaitable, Callable, Coroutine, Hashable, Iterable, Mapping
from typing import Any, Protocol, TypeAlias, TypeVar

from attrs import Attribute, field, frozen

from uoarm._control import Connection, RobotManager
from uoarm._plugins import hookimpl, hookspec
from uoarm._secrets import without_secrets
from uoarm._wire import (
    BINARY_FORM,
    TEXT_FORM,
    Form,
    dump_parts,
    read_binary,
    read_text,
    viewer_schema,
    write_binary,
)
from uoarm.model import LeaseHolder, Message, MessageStructure, Plan, StatusEvent, StopReport
from uoarm.server._failures import (
    BusyError,
    LimitError,
    UnknownError,
    code_of,
    coded_text,
    error_code_of,
    error_text,
    without_frames,
)
from uoarm.server._limits import Limits
from uoarm.server.access import (
    AccessRole,
    Approval,
    ApprovalEnvelope,
    ApprovalError,
    ApprovalFoundation,
    ApprovalPhase,
    ApprovalRequest,
    Approvals,
    DeniedError,
    Operation,
    RefusedError,
    RoleView,
    RoleViews,
    Supervision,
)
from uoarm.server.session import (
    Discoveries,
    Session,
    StatelessClient,
    StatelessClients,
    show_approval,
    show_plan,
    show_stop,
    visible_status,
)
from uoarm.server.streams import (
    Account,
    ActionRunners,
    ChangeNotice,
    Charge,
    Done,
    Envelope,
    Feed,
    FeedKey,
    FeedRegistry,
    Goal,
    GoalStatus,
    InputSender,
    Lane,
    Listener,
    Make,
    MemoryUse,
    MessageForm,
    Outbox,
    Read,
    Shares,
    StreamRunner,
    Subscription,
    Throttle,
    Watcher,
    check_message,
    is_action,
    read_message,
)

__all__ = [
    "BINARY_FORM",
    "CONTRACT_VERSION",
    "TEXT_FORM",
    "AccessRole",
    "Account",
    "ActionRunners",
    "Approval",
    "ApprovalEnvelope",
    "ApprovalError",
    "ApprovalFoundation",
    "ApprovalPhase",
    "ApprovalRequest",
    "Approvals",
    "Backend",
    "BusyError",
    "ChangeNotice",
    "Charge",
    "Client",
    "DeniedError",
    "Discoveries",
    "Done",
    "Envelope",
    "Feed",
    "FeedKey",
    "Form",
    "FrontEnd",
    "Goal",
    "GoalStatus",
    "HttpPlace",
    "InputSender",
    "Lane",
    "LimitError",
    "Listener",
    "Make",
    "MakeSession",
    "MemoryUse",
    "MessageForm",
    "Operation",
    "Outbox",
    "Read",
    "RefusedError",
    "RoleView",
    "RoleViews",
    "Session",
    "Shares",
    "StatelessClient",
    "StatelessClients",
    "StreamRunner",
    "Subscription",
    "Supervision",
    "Throttle",
    "UnknownError",
    "check_message",
    "code_of",
    "coded_text",
    "dump_parts",
    "error_code_of",
    "error_text",
    "hookimpl",
    "is_action",
    "read_binary",
    "read_message",
    "read_text",
    "show_approval",
    "show_plan",
    "show_stop",
    "viewer_schema",
    "visible_status",
    "without_frames",
    "without_secrets",
    "write_binary",
]

A = TypeVar("A")
Q = TypeVar("Q", bound=Hashable)
T = TypeVar("T")

CONTRACT_VERSION = 1
"""Of the contract of this module; that of bridges has a number of its own."""


class Client(Protocol):
    """One client that was let in, for its session.

    Its role cannot change: a client whose rights change is asked to connect again.
    """

    @property
    def identity(self) -> str:
        """Name of the session, as the audit log has it."""

    @property
    def address(self) -> str:
        """Host and port of the client, as logs have it."""

    @property
    def role(self) -> AccessRole:
        """Its rights."""

    @property
    def limits(self) -> Limits:
        """What it may use."""

    @property
    def account(self) -> Account:
        """Of the memory that is held for it; everything is released when it goes."""

    @property
    def outbox(self) -> Outbox:
        """What waits to be written to it."""

    @property
    def in_hand(self) -> int:
        """Octets of memory that the message holds which is being acted on."""

    def require(self, operation: Operation, function: str) -> None:
        """Refuse what its role does not allow; the audit log has either outcome.

        Args:
            operation: what it wants to do.
            function: with what, as the patterns of the access file name it.

        Raises:
            DeniedError: it may not.
        """

    def require_all(self, operation: Operation) -> None:
        """Refuse what its role may not do to everything, as `require` does for a function."""


class Backend(Protocol):
    """The robot behind all clients of one server, whatever protocol they speak."""

    @property
    def robot(self) -> RobotManager:
        """The manager. Its calls that wait must not be made in the loop: see `call`, `join`."""

    @property
    def limits(self) -> Limits:
        """Bounds of what clients use."""

    async def join(self, wanted: FeedKey, on_absent: Callable[[str], None] | None = None) -> Feed:
        """Return the open feed of a function, opening it for the first who asks.

        Its messages wait until a listener is added. Give it back with `leave`, once for each call.
        A cancelled call leaves nothing open.

        Args:
            wanted: the feed.
            on_absent: with it, what cannot be had yet, such as a topic without a publisher, is
                tried again until it can be; it gets the cause, at once and again when the reason is
                another one. Without it that is an error.

        Raises:
            BusyError: earlier connections to the function are being closed still.
            UoarmError: as `RobotManager.request`.
        """

    def leave(self, feed: Feed) -> None:
        """Give a feed back; the last one closes its connection, without waiting."""

    def sender(
        self,
        connection: Connection,
        account: Account,
        read: Read,
        holder: LeaseHolder | None = None,
    ) -> InputSender:
        """Return what hands a client's messages to a connection.

        Args:
            connection: of a feed that is open.
            account: charged for what is on its way.
            read: makes a message's logical value by the input's structure, in a worker.
            holder: as whom it commands inputs that have a lease; None: as itself.
        """

    async def call(self, name: str, message: Message, read: Read, timeout: float) -> Message:
        """Call a service.

        Args:
            name: of the function.
            message: the request as it came.
            read: makes its logical value by the service's structure, in a worker.
            timeout: seconds; `Limits.call_seconds` holds as well.

        Raises:
            UsageError: the function is a stream.
            BusyError: every worker is taken.
            UoarmError: as `RobotManager.call`.
        """

    @property
    def actions(self) -> ActionRunners:
        """What works on the goals of functions that are actions, for all clients together."""

    @property
    def approvals(self) -> Approvals:
        """What needs an approval, and those that are asked for."""

    async def call_planned(
        self,
        wanted: Plan | str,
        revision: int | None,
        message: Message,
        read: Read,
        timeout: float,
        began: Callable[[Callable[[], bool]], None],
        act: Callable[[Message], T],
    ) -> T:
        """Call a service, of this very plan where one is given, and of no other.

        Args:
            wanted: a plan, as `resolve` found it, or a function, whose plan is found in the worker.
            revision: of the configuration; of another one it is not called. None: of any.
            message: the request as it came.
            read: makes its logical value by the service's structure, in a worker.
            timeout: seconds, which no limit of the server shortens.
            began: called in the worker with what cancels the call, which says whether it could be.
            act: what the answer is for, in the worker, too.

        Raises:
            ApprovalError: the configuration is another one.
            UsageError: the function is a stream.
            BusyError: every worker is taken.
            UoarmError: as `RobotManager.call`.
        """

    async def stop_all(self, key: Hashable, act: Callable[[StopReport], T]) -> tuple[StopReport, T]:
        """Stop what moves, for all who ask while it lasts; goes on when they are gone.

        Args:
            key: of `act`, which is done once for all who give the same.
            act: what the report is for, in a thread that stops.
        """

    def past(self) -> list[tuple[float, StatusEvent]]:
        """Return the last changes of the robot: seconds ago, and the change."""

    def watch(self, watcher: Watcher) -> None:
        """Notify a watcher of every change of the robot, from now on."""

    def unwatch(self, watcher: Watcher) -> None:
        """Notify a watcher no more. Idempotent."""

    async def resolve(self, name: str) -> Plan:
        """Find a plan; raises as `RobotManager.resolve`, and BusyError."""

    async def structures(
        self, functions: Iterable[str]
    ) -> Mapping[str, Mapping[str, MessageStructure]]:
        """Return structures by function and port, such as `output.default`.

        Waits 0.15 s at most: what is not known by then, and what nothing provides, has none. What
        is found out later is there for the next call.
        """

    async def structure_of_type(self, name: str) -> MessageStructure | None:
        """Return what messages of a native type are like; None: nothing in this process knows it.

        Found out in a worker, five seconds at most for each plugin, and kept, whatever was found,
        until the configuration changes. A plugin that fails is logged and knows nothing.
        """

    @property
    def role_views(self) -> RoleViews:
        """What each role sees; every text that goes to a client passes `RoleView.text`."""

    def view(self, make: Make[Q, A], question: Q) -> Awaitable[A]:
        """Return the answer to what is asked of the whole robot.

        It is made in one thread beside the loop, from a moment after the question: once for all who
        ask it meanwhile. What grows with the robot belongs there.

        Args:
            make: gets every question that has come, and returns the answer to each. An exception in
                the place of an answer is raised to who asked. It must be equal for all who share.
            question: hashable.

        Raises:
            BusyError: the server is closing.
        """

    async def in_worker(self, action: Callable[[], T]) -> T:
        """Return what an action returns that takes its time, such as the check of a long message.

        It waits for a free worker, and must end by itself.
        """

    def open_account(self) -> Account:
        """Return an account for what no single client caused. Close it."""


MakeSession: TypeAlias = "Callable[[Client], Session]"
"""Makes the session of a client that has come."""


def _is_path(front_end: FrontEnd, attribute: Attribute[str], value: str) -> None:
    del front_end, attribute
    if (
        not value.startswith("/")
        or value != value.strip()
        or set(value) & set("?#")
        or value == "/"
    ):
        raise ValueError(f"path: expected one such as '/name', got {value!r}")


@frozen
class HttpPlace:
    """Where a front end with HTTP of its own listens, and whom it lets in.

    Attributes:
        backend: the robot.
        stateless_clients: admit each request; nothing is done for one that was not.
        sockets: bound and listening; the server closes them.
        tls: what TLS is spoken with; None: none is.
    """

    backend: FeedRegistry
    stateless_clients: StatelessClients
    sockets: tuple[socket.socket, ...]
    tls: ssl.SSLContext | None


@frozen
class FrontEnd:
    """A protocol that clients of a server may speak.

    Attributes:
        name: by which settings and logs name it.
        summary: one line for people.
        path: of its endpoint, `/name`; what the server has itself it keeps.
        start: called once when a server starts, in its loop; returns what makes the session of a
            client. What is common to all clients of the protocol belongs to it. None: `serve`.
        subprotocols: WebSocket subprotocols that it speaks, of which the client's first choice is
            taken. With none, or where the client offers none of them, there is no subprotocol.
        serve: serves HTTP of its own until it is cancelled, in the server's loop, on a port of its
            own: without one (`ServerOptions.front_end_ports`) it is not called. None: `start`.
        contract: the version of this contract that it was written for: a number that stands in
            its source, never `CONTRACT_VERSION`, which is that of the uoarm that runs.
    """

    name: str
    summary: str
    path: str = field(validator=_is_path)
    start: Callable[[Backend], MakeSession] | None = None
    subprotocols: tuple[str, ...] = ()
    serve: Callable[[HttpPlace], Coroutine[Any, Any, None]] | None = None
    contract: int = field(kw_only=True)

    def __attrs_post_init__(self) -> None:
        if (self.start is None) is (self.serve is None):
            raise ValueError(f"{self}: expected either start or serve")

    def __str__(self) -> str:
        """Return how it is named to people."""
        return f"the front end {self.name!r}"


class FrontEndHooks:
    """The hooks that a module behind an entry point of group `uoarm.front_ends` implements."""

    @hookspec
    def uoarm_front_ends(self) -> list[FrontEnd]:
        """Return the front ends of this plugin.

        Called once when a server is made. Names and paths must differ from those of all others.
        """
        raise NotImplementedError
