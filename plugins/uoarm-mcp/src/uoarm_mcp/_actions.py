"""What an agent does with functions: calls, messages, goals, where they fit and are approved.

Work that lasts has a handle at once, says how it stands, and has one end; it can be cancelled.
"""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import time
from collections import OrderedDict
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Any

from attrs import define, evolve, field
from mcp_types import CallToolResult, ResourceLink

from uoarm.errors import MessageError, UoarmError, UsageError
from uoarm.model import FieldLimit, Message, MessageStructure, Plan, message_octets
from uoarm.server.front_end import (
    TEXT_FORM,
    ApprovalFoundation,
    ApprovalRequest,
    Backend,
    DeniedError,
    Goal,
    GoalStatus,
    LimitError,
    RoleView,
    StatelessClient,
    UnknownError,
    check_message,
    read_message,
    show_approval,
)
from uoarm_mcp._catalogue import FunctionTool, ToolKind
from uoarm_mcp._schemas import APPROVAL, tool_arguments
from uoarm_mcp._streams import AgentStreams
from uoarm_mcp._values import KeptValues, RenderedMessage, failure_text, render, succeeded

_MOST_RUNNING = 32
_MOST_KEPT = 128


@define(eq=False)
class AgentGoal:
    """One piece of work.

    Attributes:
        handle: by which the agent knows it; of what needed an approval it is that of the approval.
        function: which function works on it.
        state: `running`, or how it ended, in the framework's own word.
        result: what it came to.
        cause: why it failed.
        feedback: what came last before the result.
        shown: that as it was shown, if it was.
        cancel: asks for its end; returns whether that could be asked.
        stop: stops what it moves, in the loop; returns whether anything is.
        done: set at its end.
        is_reported: whether its end was reported.
    """

    handle: str
    function: str
    state: str = "running"
    result: RenderedMessage | None = None
    cause: str = ""
    feedback: Message = None
    shown: RenderedMessage | None = None
    cancel: Callable[[], bool] | None = None
    stop: Callable[[], bool] | None = None
    is_cancelled: bool = False
    is_reported: bool = False
    began: float = field(factory=time.monotonic)
    ended: float | None = None
    done: asyncio.Event = field(factory=asyncio.Event)

    def facts(self) -> dict[str, Any]:
        """Return how it stands, as data; the end is reported once with its result."""
        facts: dict[str, Any] = {
            "state": self.state,
            "handle": self.handle,
            "function": self.function,
            "seconds": round((self.ended or time.monotonic()) - self.began, 3),
        }
        if self.is_cancelled and self.state == "running":
            facts["cancelling"] = True
        if self.done.is_set():
            facts["first_report"] = not self.is_reported
            self.is_reported = True
        if self.cause:
            facts["cause"] = self.cause
        if self.result is not None:
            facts["summary" if self.result.is_summary else "result"] = self.result.value
        return facts


class AgentGoals:
    """The goals of one agent, in the server's loop."""

    def __init__(self) -> None:
        self._goals: OrderedDict[str, AgentGoal] = OrderedDict()
        self._tasks: set[asyncio.Task[None]] = set()

    def all(self) -> list[AgentGoal]:
        """Return those that are known, oldest first."""
        return list(self._goals.values())

    def find(self, handle: str) -> AgentGoal:
        """Return one; raises UnknownError."""
        goal = self._goals.get(handle)
        if goal is None:
            raise UnknownError(f"there is no goal {handle!r:.64} of this agent")
        return goal

    def knows(self, handle: str) -> bool:
        """Say whether there is one."""
        return handle in self._goals

    def links(self, handle: str) -> tuple[ResourceLink, ...]:
        """Return the links to what the result of a goal, or its feedback, leaves out."""
        goal = self._goals.get(handle)
        rendered = None if goal is None else goal.result or goal.shown
        return () if rendered is None else rendered.links

    def check_room(self) -> None:
        """Refuse more than an agent may have under way; raises LimitError."""
        if len(self._tasks) >= _MOST_RUNNING:
            raise LimitError(f"{len(self._tasks)} goals are under way; wait for one of them first")

    def start(
        self,
        goal: AgentGoal,
        work: Callable[[AgentGoal], Awaitable[RenderedMessage]],
        text: Callable[[str], str],
    ) -> None:
        """Begin with a goal, which `check_room` had room for."""
        self._goals[goal.handle] = goal
        if len(self._goals) > _MOST_KEPT:
            oldest = next(handle for handle, item in self._goals.items() if item.done.is_set())
            del self._goals[oldest]
        task = asyncio.ensure_future(self._run(goal, work, text))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def forget(self, goal: AgentGoal) -> None:
        """Know one no more that was not begun with."""
        self._goals.pop(goal.handle, None)

    def cancel(self, goal: AgentGoal) -> bool:
        """Ask for a goal's end; returns whether the framework could be asked."""
        goal.is_cancelled = True
        return goal.cancel is not None and goal.cancel()

    def running(self) -> list[AgentGoal]:
        """Return those that are under way, oldest first."""
        return [goal for goal in self._goals.values() if not goal.done.is_set()]

    def stop_own(self) -> list[str]:
        """Stop what goals under way move by an input; returns which."""
        return [f"{goal.function}.goal" for goal in self.running() if goal.stop and goal.stop()]

    def close(self) -> None:
        """Stop what moves, and ask for the end of all that is under way."""
        self.stop_own()
        for goal in self.running():
            self.cancel(goal)

    async def _run(
        self,
        goal: AgentGoal,
        work: Callable[[AgentGoal], Awaitable[RenderedMessage]],
        text: Callable[[str], str],
    ) -> None:
        try:
            goal.result = await work(goal)
            if goal.state == "running":
                goal.state = "succeeded"
        except UoarmError as error:
            goal.state = "canceled" if goal.is_cancelled else "failed"
            goal.cause = text(failure_text(error))
        except Exception as error:  # noqa: BLE001 - the end is reported, whatever it is
            goal.state = "failed"
            goal.cause = failure_text(error)
        finally:
            goal.ended = time.monotonic()
            goal.done.set()


async def within(seconds: float, event: asyncio.Event) -> None:
    """Wait for an event, for so many seconds at most."""
    if event.is_set():
        return
    with contextlib.suppress(asyncio.TimeoutError):
        await asyncio.wait_for(event.wait(), seconds)


_AT_ONCE_SECONDS = 5.0
_WORDS = 200
_read = partial(read_message, TEXT_FORM)


@define(eq=False)
class AgentActions:
    """What one agent does and asks approval for, in the server's loop.

    Each begins with a goal; what ends at once is answered at once.
    """

    _client: StatelessClient
    _backend: Backend
    _kept: KeptValues
    _streams: AgentStreams
    _goals: AgentGoals
    _cancelling: set[asyncio.Future[bool]] = field(factory=set, init=False)

    @property
    def _view(self) -> RoleView:
        return self._backend.role_views.of(self._client.role)

    async def act(self, made: FunctionTool, arguments: Mapping[str, Any]) -> CallToolResult:
        """Call or send, where it fits and is approved."""
        if made.kind is ToolKind.CALL and APPROVAL not in arguments and not self.reason(made):
            return await self._call_at_once(made, arguments)
        plan, revision = await self.find_plan(made.function)
        message, handle = _checked(plan, made, arguments)
        request = self.request(made, message, plan, revision)
        if self.reason(made):
            if not handle:
                return succeeded(self.ask(made, request))
            self._goals.check_room()  # or the approval would be spent on nothing
            approval = self._backend.approvals.use(handle, request)
            goal_handle = handle if approval.uses == 1 else f"{handle}-{approval.uses}"
        elif handle:
            raise UsageError(f"{APPROVAL}: it needs no approval; leave it out")
        else:
            goal_handle = secrets.token_hex(8)
        goal = AgentGoal(goal_handle, made.function)
        work: Callable[[AgentGoal], Awaitable[RenderedMessage]]
        if made.kind is ToolKind.CALL:
            work = partial(self._call, plan, revision, message, _read)
        elif made.kind is ToolKind.GOAL:
            own = {port.name: port for port in plan.provider.component.inputs if not port.source}
            command = own["goal"].endpoint.command
            can_stop = command is not None and command.stop is not None
            work = partial(
                self._give_goal,
                made,
                request,
                message,
                can_cancel="cancel" in own,
                can_stop=can_stop,
            )
        else:
            work = partial(self._send, made, request, message)
        return await self._pursue(goal, work)

    async def _call_at_once(
        self, made: FunctionTool, arguments: Mapping[str, Any]
    ) -> CallToolResult:
        """Call what needs no approval: found, checked, called and shown by one worker."""
        goal = AgentGoal(secrets.token_hex(8), made.function)
        refusals: list[UoarmError] = []

        def read(structure: MessageStructure, message: Message) -> Message:
            try:
                # Again: the plan may be of a configuration that is newer than the question above.
                if reason := self.reason(made):
                    raise UsageError(f"it needs an approval since just now: {reason}; try again")
                message, _ = tool_arguments(structure).split(message)
                return check_message(structure, message, _read, made.tool.name)
            except UoarmError as error:
                refusals.append(error)
                raise

        result = await self._pursue(goal, partial(self._call, made.function, None, arguments, read))
        if refusals:
            self._goals.forget(goal)
            raise refusals[0]
        return result

    async def _pursue(
        self, goal: AgentGoal, work: Callable[[AgentGoal], Awaitable[RenderedMessage]]
    ) -> CallToolResult:
        self._goals.check_room()
        self._goals.start(goal, work, lambda text: self._view.text(text, goal.function))
        try:
            await within(_AT_ONCE_SECONDS, goal.done)
        except asyncio.CancelledError:  # by the request, whose client has no handle to cancel it
            if not goal.is_cancelled:
                cancelling = asyncio.ensure_future(
                    self._backend.in_worker(partial(self._goals.cancel, goal))
                )
                self._cancelling.add(cancelling)
                cancelling.add_done_callback(self._cancelling.discard)
            raise
        return self._goal_result(goal)

    async def _call(
        self,
        wanted: Plan | str,
        revision: int | None,
        message: Message,
        read: Callable[[MessageStructure, Message], Message],
        goal: AgentGoal,
    ) -> RenderedMessage:
        timeout = self._client.limits.call_seconds
        if not isinstance(wanted, str):
            service = wanted.provider.component.service
            if service is None:
                raise UsageError(f"{wanted.function!r} is not a service any more")
            command = service.endpoint.command
            timeout = (None if command is None else command.lifetime) or timeout

        def began(cancel: Callable[[], bool]) -> None:
            goal.cancel = cancel
            if goal.is_cancelled:
                cancel()

        rendered = await self._backend.call_planned(
            wanted, revision, message, read, timeout, began, render
        )
        return self._kept.keep(rendered)

    async def _send(
        self, made: FunctionTool, request: ApprovalRequest, message: Message, goal: AgentGoal
    ) -> RenderedMessage:
        del goal
        check = partial(self.check_foundation, made, request)
        await self._streams.send(made.function, made.port, message, check)
        return RenderedMessage(None)

    async def _give_goal(
        self,
        made: FunctionTool,
        request: ApprovalRequest,
        message: Message,
        goal: AgentGoal,
        *,
        can_cancel: bool,
        can_stop: bool,
    ) -> RenderedMessage:
        """Give a goal to an action, and wait for its end; its cancellation reaches the action."""
        loop = asyncio.get_running_loop()
        ended: asyncio.Future[tuple[Message, str]] = loop.create_future()

        def feed(values: Message) -> None:
            goal.feedback, goal.shown = values, None

        def finish(values: Message, status: GoalStatus) -> None:
            if not ended.done():
                ended.set_result((values, status.name.lower()))

        def fail(error: BaseException) -> None:
            if not ended.done():
                ended.set_exception(error)

        sent = Goal(
            message,
            feed,
            finish,
            fail,
            message_octets(message),
            read=_read,
            check=partial(self.check_foundation, made, request),
        )
        actions = self._backend.actions
        runner = actions.join(made.function, sent)

        def ask_for_end() -> None:
            with contextlib.suppress(UoarmError):  # its end is reported, whatever it is
                runner.cancel(sent, lambda _: None)

        def cancel() -> bool:
            loop.call_soon_threadsafe(ask_for_end)
            return True

        try:
            runner.start(sent)
            if can_cancel:
                goal.cancel = cancel
            if can_stop:
                goal.stop = partial(runner.stop, sent)
            values, state = await ended
        finally:
            if not sent.ended:
                runner.abandon(sent)
            actions.leave(made.function, sent)
        rendered = self._kept.keep(await self._backend.in_worker(partial(render, values)))
        goal.state = state
        return rendered

    def check_foundation(self, made: FunctionTool, request: ApprovalRequest, plan: Plan) -> None:
        """Refuse a plan that runs, where another one was approved; raises DeniedError."""
        found = ApprovalFoundation.of(plan, self._backend.robot.revision)
        if self.reason(made) and found != request.foundation:
            raise DeniedError(
                f"{made.function} runs {', '.join(found.components)}, which was not approved"
            )

    def _goal_result(self, goal: AgentGoal) -> CallToolResult:
        facts = goal.facts()
        if not goal.done.is_set():
            facts["next"] = f"it goes on: wait, goal_status or cancel with handle {goal.handle}"
        failed = goal.done.is_set() and goal.state != "succeeded"
        return succeeded(facts, self._goals.links(goal.handle), is_error=failed)

    def reason(self, made: FunctionTool) -> str:
        """Return why it needs an approval now, whatever the catalogue says."""
        return self._backend.approvals.supervision.reason(made.operation, made.function)

    def request(
        self, made: FunctionTool, message: Message, plan: Plan, revision: int
    ) -> ApprovalRequest:
        """Return what an approval would have to be of."""
        return ApprovalRequest(
            self._client.principal,
            made.operation.value,
            made.function,
            made.port,
            message,
            ApprovalFoundation.of(plan, revision),
        )

    def ask(self, made: FunctionTool, request: ApprovalRequest) -> dict[str, Any]:
        """Ask for an approval; returns how it stands, as data."""
        description = self._backend.robot.config.functions[made.function].description
        preview = f"{description or made.function}; {self.reason(made)}"
        approval = self._backend.approvals.ask(evolve(request, preview=preview[:_WORDS]))
        return {
            "state": "approval-needed",
            "handle": approval.id,
            "approval": show_approval(self._backend.approvals, approval, self._view),
            "next": (
                f"another person than {self._client.principal} decides about it; then call "
                f"{made.tool.name} again with the same arguments and {APPROVAL} {approval.id}"
            ),
        }

    async def find_plan(self, function: str) -> tuple[Plan, int]:
        """Return the plan of a function, and the revision that it is of at the latest."""
        revision = self._backend.robot.revision
        plan = await self._backend.resolve(function)
        return plan, revision


def _checked(plan: Plan, made: FunctionTool, arguments: Mapping[str, Any]) -> tuple[Message, str]:
    """Return the message of a tool's arguments and the approval, where the message fits."""
    message, handle = tool_arguments(_structure(plan, made)).split(arguments)
    check_arguments(plan, made, message)
    return message, handle


def check_arguments(plan: Plan, made: FunctionTool, message: Message) -> None:
    """Refuse what does not fit, with the field and why; nothing has been asked of a bridge."""
    check_message(_structure(plan, made), message, _read, made.tool.name)
    for limit in _limits(plan, made):
        value = message if limit.path == "." else _at(message, limit.path)
        if value is None:
            continue
        if not isinstance(value, int | float) or isinstance(value, bool):
            raise MessageError(f"{made.tool.name}: {limit.path}: expected a number, got {value!r}")
        if limit.minimum is not None and not value >= limit.minimum:
            raise MessageError(
                f"{made.tool.name}: {limit.path}: {value} is below its limit {limit.minimum}"
            )
        if limit.maximum is not None and not value <= limit.maximum:
            raise MessageError(
                f"{made.tool.name}: {limit.path}: {value} is above its limit {limit.maximum}"
            )


def _limits(plan: Plan, made: FunctionTool) -> tuple[FieldLimit, ...]:
    """Return the limits of the input that a tool sends to, which hold at the last hop, too."""
    if made.kind not in {ToolKind.SEND, ToolKind.GOAL}:
        return ()
    own = [port for port in plan.provider.component.inputs if port.source is None]
    found = next((port for port in own if port.name == made.port or not made.port), None)
    command = None if found is None else found.endpoint.command
    return () if command is None else command.limits


def _at(message: Message, path: str) -> Message:
    for name in path.split("."):
        if not isinstance(message, Mapping):
            return None
        message = message.get(name)
    return message


def _structure(plan: Plan, made: FunctionTool) -> MessageStructure:
    structures = plan.provider.structures
    if made.kind is ToolKind.CALL:
        name = "request"
    else:
        own = [port.name for port in plan.provider.component.inputs if port.source is None]
        name = f"input.{made.port or (own[0] if own else 'default')}"
    structure = structures.get(name)
    if structure is None:
        raise UsageError(f"{made.function!r} is another one now: list the tools again")
    return structure
