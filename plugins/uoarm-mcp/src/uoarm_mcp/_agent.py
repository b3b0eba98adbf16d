"""One agent: what its tools do, with what it has open, its goals and its approvals."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
from collections.abc import Awaitable, Callable, Mapping
from functools import cache, partial
from typing import Any

import orjson
from attrs import evolve
from jsonschema import Draft202012Validator
from jsonschema.exceptions import best_match
from mcp_types import CallToolResult, ImageContent, ResourceLink, TextContent, Tool

from uoarm.errors import MessageError, ResolutionError, UoarmError, UsageError
from uoarm.model import FieldLimit, LeaseHolder, Message, MessageStructure, Plan, message_octets
from uoarm.server.front_end import (
    TEXT_FORM,
    Approval,
    ApprovalEnvelope,
    ApprovalFoundation,
    ApprovalPhase,
    ApprovalWish,
    Backend,
    DeniedError,
    Discoveries,
    Goal,
    GoalStatus,
    Guest,
    Operation,
    RoleView,
    UnknownError,
    check_message,
    code_of,
    error_text,
    is_action,
    read_message,
    show_approval,
    show_plan,
    show_stop,
    visible_status,
)
from uoarm_mcp._catalogue import STREAM, Catalogue, CatalogueMaker, FunctionTool, ToolKind
from uoarm_mcp._goals import AgentGoal, AgentGoals
from uoarm_mcp._schemas import APPROVAL, OWN_INPUTS, tool_arguments
from uoarm_mcp._streams import AgentStreams
from uoarm_mcp._values import KeptValues, RenderedMessage, is_picture, picture_of

__all__ = ["Agent"]

_AT_ONCE_SECONDS = 5.0
_WAIT_SECONDS = 20.0
_READ_SECONDS = 5.0
_MOST_EVENTS = 20
_MOST_SHOWN = 60_000
_WORDS = 200
_KINDS = {
    "call": (ToolKind.CALL,),
    "send": (ToolKind.SEND, ToolKind.GOAL),
    "request": (ToolKind.READ,),
}
_read = partial(read_message, TEXT_FORM)


class Agent:
    """All requests of one guest, in the server's loop.

    Args:
        guest: whose.
        backend: the robot.
        catalogues: what roles have.
        discoveries: what bridges see.
    """

    def __init__(
        self,
        guest: Guest,
        backend: Backend,
        catalogues: CatalogueMaker,
        discoveries: Discoveries,
    ) -> None:
        self.guest = guest
        self.kept = KeptValues(guest.account)
        self._backend = backend
        self._desk = backend.approvals
        self._catalogues = catalogues
        self._discoveries = discoveries
        holder = LeaseHolder(f"agent {guest.principal} {guest.identity}", guest.role.name)
        self.streams = AgentStreams(backend, guest.account, holder)
        self._goals = AgentGoals()
        self._under_way = 0
        self._decided: dict[str, asyncio.Event] = {}
        self._own: Mapping[str, Callable[[Mapping[str, Any]], Awaitable[dict[str, Any]]]] = {
            "plan": self._plan,
            "status": self._status,
            "explain_failure": self._explain,
            "discover": self._discover,
            "stop": self._stop,
            "goal_status": self._goal_status,
            "wait": self._wait,
            "cancel": self._cancel,
        }
        self._desk.watch(self._changed)

    @property
    def view(self) -> RoleView:
        """What its role sees."""
        return self._backend.role_views.of(self.guest.role)

    def close(self) -> None:
        """Let go of everything: what it moved is stopped."""
        self._desk.unwatch(self._changed)
        self._goals.close()
        self.streams.close()

    async def catalogue(self) -> Catalogue:
        """Return what it has."""
        return await self._catalogues.of(self.guest.role)

    async def tools(self) -> list[Tool]:
        """Return its tools."""
        catalogue = await self.catalogue()
        return [*catalogue.own, *(made.tool for made in catalogue.tools.values())]

    async def call(self, name: str, arguments: Mapping[str, Any]) -> CallToolResult:
        """Use a tool; what goes wrong is in the result.

        Raises:
            UnknownError: there is no such tool for this role.
        """
        catalogue = await self.catalogue()
        if name not in self._own and name not in catalogue.tools:
            known = catalogue.left_out.get(name, "")
            raise UnknownError(f"there is no tool {name!r:.200}{known and f': {known}'}")
        if self._under_way >= self.guest.limits.calls:
            return _failed("limit", f"{self._under_way} calls are under way; wait for one of them")
        self._under_way += 1
        try:
            if name in self._own:
                _check_own(name, arguments)
                return _succeeded(await self._own[name](arguments))
            made = catalogue.tools[name]
            self.guest.require(made.operation, made.function)
            if made.kind is ToolKind.READ:
                return await self._use_stream(made, arguments)
            return await self._act(made, arguments)
        except UoarmError as error:
            if isinstance(error, UnknownError) and name not in self._own:
                raise
            return _failed(code_of(error), self.view.text(str(error), str(arguments)))
        except Exception as error:  # noqa: BLE001 - the agent gets an answer, the log the cause
            return _failed("internal", error_text(error))
        finally:
            self._under_way -= 1

    # Doing something

    async def _act(self, made: FunctionTool, arguments: Mapping[str, Any]) -> CallToolResult:
        """Call or send, where it fits and is approved."""
        if made.kind is ToolKind.CALL and APPROVAL not in arguments and not self._reason(made):
            return await self._call_at_once(made, arguments)
        plan, revision = await self._found(made.function)
        message, handle = _checked(plan, made, arguments)
        wish = self._wish(made, message, plan, revision)
        if self._reason(made):
            if not handle:
                return self._ask(made, plan, wish)
            approval = self._desk.use(handle, wish)
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
            own = {port.name for port in plan.provider.component.inputs if port.source is None}
            work = partial(self._give_goal, made, wish, message, can_cancel="cancel" in own)
        else:
            work = partial(self._send, made, wish, message)
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
                if reason := self._reason(made):
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
        self._goals.start(goal, work, lambda text: self.view.text(text, goal.function))
        await _within(_AT_ONCE_SECONDS, goal.done)
        return self._goal_result(goal)

    async def _call(
        self,
        wanted: Plan | str,
        revision: int | None,
        message: Message,
        read: Callable[[MessageStructure, Message], Message],
        goal: AgentGoal,
    ) -> RenderedMessage:
        timeout = self.guest.limits.call_seconds
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

        return await self._backend.call_planned(
            wanted, revision, message, read, timeout, began, self.kept.render
        )

    async def _send(
        self, made: FunctionTool, wish: ApprovalWish, message: Message, goal: AgentGoal
    ) -> RenderedMessage:
        del goal
        check = partial(self._check_foundation, made, wish)
        await self.streams.send(made.function, made.port, message, check)
        return RenderedMessage(None)

    async def _give_goal(
        self,
        made: FunctionTool,
        wish: ApprovalWish,
        message: Message,
        goal: AgentGoal,
        *,
        can_cancel: bool,
    ) -> RenderedMessage:
        """Give a goal to an action, and wait for its end; its cancellation reaches the action."""
        loop = asyncio.get_running_loop()
        ended: asyncio.Future[tuple[Message, str]] = loop.create_future()

        def feed(values: Message) -> None:
            goal.feedback = values

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
            check=partial(self._check_foundation, made, wish),
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
            values, state = await ended
        finally:
            if not sent.ended:
                runner.abandon(sent)
            actions.leave(made.function, sent)
        rendered = await self._backend.in_worker(lambda: self.kept.render(values))
        goal.state = state
        return rendered

    def _check_foundation(self, made: FunctionTool, wish: ApprovalWish, plan: Plan) -> None:
        found = ApprovalFoundation.of(plan, self._backend.robot.revision)
        if self._reason(made) and found != wish.foundation:
            raise DeniedError(
                f"{made.function} runs {', '.join(found.components)}, which was not approved"
            )

    def _goal_result(self, goal: AgentGoal) -> CallToolResult:
        facts = goal.facts()
        if not goal.done.is_set():
            facts["next"] = f"it goes on: wait, goal_status or cancel with handle {goal.handle}"
        links = () if goal.result is None else goal.result.links
        failed = goal.done.is_set() and goal.state != "succeeded"
        return _succeeded(facts, links, is_error=failed)

    # Approvals

    def _reason(self, made: FunctionTool) -> str:
        """Return why it needs an approval now, whatever the catalogue says."""
        return self._desk.supervision.reason(made.operation, made.function)

    def _wish(
        self, made: FunctionTool, message: Message, plan: Plan, revision: int
    ) -> ApprovalWish:
        return ApprovalWish(
            self.guest.principal,
            made.operation.value,
            made.function,
            made.port,
            message,
            ApprovalFoundation.of(plan, revision),
        )

    def _ask(self, made: FunctionTool, plan: Plan, wish: ApprovalWish) -> CallToolResult:
        return _succeeded(self._asked(made, plan, wish))

    def _asked(self, made: FunctionTool, plan: Plan, wish: ApprovalWish) -> dict[str, Any]:
        del plan
        description = self._backend.robot.config.functions[made.function].description
        preview = f"{description or made.function}; {self._reason(made)}"
        approval = self._desk.ask(evolve(wish, preview=preview[:_WORDS]))
        return {
            "state": "approval-needed",
            "handle": approval.id,
            "approval": show_approval(self._desk, approval, self.view),
            "next": (
                f"another person than {self.guest.principal} decides about it; then call "
                f"{made.tool.name} again with the same arguments and {APPROVAL} {approval.id}"
            ),
        }

    def _changed(self, approval: Approval) -> None:
        event = self._decided.get(approval.id)
        if event is not None and approval.phase is not ApprovalPhase.PENDING:
            event.set()

    # Streams

    async def _use_stream(self, made: FunctionTool, arguments: Mapping[str, Any]) -> CallToolResult:
        problem = best_match(_validator_of(made).iter_errors(arguments))
        if problem is not None:
            raise MessageError(_problem_text(problem))
        options = dict(arguments)
        handle = options.pop(APPROVAL, "")
        output = options.get("output", made.outputs[0])
        if self._reason(made):
            plan, revision = await self._found(made.function)
            wish = self._wish(made, options, plan, revision)
            if not handle:
                facts = self._asked(made, plan, wish)
                return _succeeded({"messages": [], **facts})
            self._desk.use(handle, wish)
        collector, end = await self.streams.read(
            f"{made.function}.{output}",
            options.get("count", 1),
            options.get("seconds", _READ_SECONDS),
            latest=options.get("latest", True),
        )
        messages = collector.messages
        pictures: list[ImageContent] = []
        if options.get("picture"):
            pictures = [
                await self._backend.in_worker(partial(picture_of, message))
                for message in messages[:4]
                if is_picture(message)
            ]
        rendered = await self._backend.in_worker(
            lambda: [self.kept.render(message) for message in messages]
        )
        facts = {
            "messages": [item.value for item in rendered if not item.is_summary],
            "lost": collector.lost,
        }
        summaries = [item.value for item in rendered if item.is_summary]
        if summaries:
            facts["summaries"] = summaries
        if end:
            facts["ended"] = self.view.text(end, made.function)
        return _succeeded(facts, [link for item in rendered for link in item.links], pictures)

    async def latest(self, uri: str) -> tuple[str, bytes]:
        """Return the newest message of a stream as a resource: its kind and octets.

        Raises:
            UnknownError: the role has no such stream.
        """
        function, output = await self.stream_of(uri)
        collector, end = await self.streams.read(
            f"{function}.{output}", 1, _READ_SECONDS, latest=True
        )
        if not collector.messages:
            raise UsageError(
                f"no message of {function} came in {_READ_SECONDS:g} s{end and f'; {end}'}"
            )
        message = collector.messages[0]
        if isinstance(message, Mapping) and is_picture(message):
            return "application/octet-stream", bytes(message["data"])
        text = await self._backend.in_worker(lambda: TEXT_FORM.write(message))
        return "application/json", text

    async def stream_of(self, uri: str) -> tuple[str, str]:
        """Return function and output of a stream's address; raises UnknownError."""
        catalogue = await self.catalogue()
        if uri not in catalogue.resources:
            raise UnknownError(f"there is no resource {uri!r:.200}")
        function, _, output = uri.removeprefix(STREAM).partition("/")
        self.guest.require(Operation.REQUEST, function)
        if not output:
            made = catalogue.tools.get(f"read_{function}")
            output = made.outputs[0] if made is not None else "default"
        return function, output

    # Tools that every robot has

    async def _plan(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        name = arguments["function"].partition(".")[0]
        self.guest.require(Operation.SEE, name)
        revision = self._backend.robot.revision
        try:
            plan = await self._backend.resolve(arguments["function"])
        except ResolutionError as error:
            return {
                "function": name,
                "possible": False,
                "why": self.view.text(str(error), name),
                "state": "impossible",
            }
        shown = show_plan(plan, TEXT_FORM, self.view)
        facts: dict[str, Any] = {
            "function": name,
            "possible": True,
            "state": "possible",
            "opens": shown["text"][:_MOST_SHOWN],
            "components": [
                step.component.name
                for step in plan.steps
                if self.view.has_component(step.component.name)
            ],
            "warnings": shown["plan"]["warnings"],
        }
        catalogue = await self.catalogue()
        made = self._meant(catalogue, name, plan, arguments)
        if made is None:
            return facts
        facts["tool"] = made.tool.name
        reason = self._reason(made)
        facts["needs_approval"] = self.view.text(reason, name)
        if "arguments" not in arguments:
            return facts
        self.guest.require(made.operation, name)
        message: Message = arguments["arguments"]
        if made.kind is not ToolKind.READ:
            _check(plan, made, message)
        facts["arguments"] = "they fit"
        if reason:
            given = arguments.get("envelope", {})
            envelope = ApprovalEnvelope(
                {path: (least, most) for path, (least, most) in given.get("ranges", {}).items()},
                given.get("count", 1),
                given.get("rate"),
            )
            wish = evolve(
                self._wish(made, message, plan, revision),
                envelope=envelope,
                seconds=float(arguments.get("seconds", 60.0)),
            )
            facts |= self._asked(made, plan, wish)
        return facts

    def _meant(
        self, catalogue: Catalogue, name: str, plan: Plan, arguments: Mapping[str, Any]
    ) -> FunctionTool | None:
        """Return the tool that a plan is about."""
        wanted = arguments.get("operation")
        if wanted is None:
            is_service = plan.provider.component.service is not None
            own = [port for port in plan.provider.component.inputs if port.source is None]
            is_sent = "arguments" in arguments or is_action(plan.provider.component)
            wanted = "call" if is_service else "send" if own and is_sent else "request"
        kinds = _KINDS[wanted]
        return next(
            (
                made
                for made in catalogue.tools.values()
                if made.function == name
                and made.kind in kinds
                and (made.kind is ToolKind.GOAL or arguments.get("port", made.port) == made.port)
            ),
            None,
        )

    async def _status(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        del arguments
        view, role = self.view, self.guest.role
        catalogue = await self.catalogue()
        status = await self._backend.in_worker(
            lambda: visible_status(self._backend.robot.status(), view)
        )
        functions = self._backend.robot.config.functions
        approvals = [
            show_approval(self._desk, approval, view)
            for approval in self._desk.asked_by(self.guest.principal)
        ]
        warnings = []
        if self.guest.principal == "local":
            warnings.append(
                "without an access file there is one principal, who can approve nothing: what "
                "moves something cannot be done"
            )
        elif not role.supervised:
            warnings.append(
                f"role {role.name!r} is not supervised: with its token what moves something can be "
                "done over other protocols without an approval"
            )
        return {
            "state": "held" if status.held is not None else "running",
            "role": role.name,
            "principal": self.guest.principal,
            "warnings": warnings,
            "functions": {
                name: function.description
                for name, function in functions.items()
                if view.has_function(name)
            },
            "components": {
                component.name: ": ".join(filter(None, (component.health.value, component.cause)))
                for component in status.components
            },
            "connections": {
                connection.function: connection.state.value for connection in status.connections
            },
            "open": self.streams.open,
            "left_out": dict(catalogue.left_out),
            "goals": {goal.handle: f"{goal.function}: {goal.state}" for goal in self._goals.all()},
            "approvals": approvals,
        }

    async def _explain(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        if "handle" in arguments:
            return await self._goal_status({"handle": arguments["handle"]})
        name = arguments.get("function", "")
        if not name:
            raise UsageError("give a function or a handle")
        self.guest.require(Operation.SEE, name)
        view = self.view
        try:
            await self._backend.resolve(name)
            why = "a plan is found now"
        except UoarmError as error:
            why = view.text(str(error), name)
        status = await self._backend.in_worker(
            lambda: visible_status(self._backend.robot.status(), view)
        )
        events = [
            f"{age:.1f} s ago: {event.subject} {event.change}{event.cause and ': '}"
            f"{view.text(event.cause, name)}"
            for age, event in self._backend.past()
            if event.function == name and view.has_event(event)
        ]
        return {
            "function": name,
            "state": "explained",
            "why": why,
            "components": [
                {
                    "component": component.name,
                    "health": component.health.value,
                    "cause": component.cause,
                    "last_error": component.last_error,
                    "failed": component.failed,
                }
                for component in status.components
                if component.function == name
            ],
            "events": events[-_MOST_EVENTS:],
        }

    async def _discover(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        del arguments
        self.guest.require_all(Operation.SEE)
        found = await self._discoveries.look()
        return {"bridges": found}

    async def _stop(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        del arguments
        if not self.guest.role.allows_all(Operation.STOP):
            cancelled = [
                goal.handle
                for goal in self._goals.all()
                if not goal.done.is_set() and self._goals.cancel(goal)
            ]
            return {"stopped": self.streams.stop_own(), "cancelled": cancelled}
        self.guest.require_all(Operation.STOP)
        view = self.view
        report, shown = await self._backend.stop_all(
            (view.role, "mcp"), lambda report: show_stop(report, view)
        )
        self.guest.note_stop(report)
        return shown

    async def _goal_status(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        handle = arguments["handle"]
        if self._goals.knows(handle):
            goal = self._goals.find(handle)
            if goal.done.is_set() or goal.feedback is None:
                return goal.facts()
            last = goal.feedback
            shown = await self._backend.in_worker(lambda: self.kept.render(last))
            return {**goal.facts(), "feedback": shown.value}
        approval = self._desk.find(handle, self.guest.principal)
        if approval is None:
            raise UnknownError(f"there is no goal and no approval {handle!r:.64} of this agent")
        return {
            "state": approval.phase.value,
            "handle": handle,
            "approval": show_approval(self._desk, approval, self.view),
        }

    async def _wait(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        handle, seconds = arguments["handle"], arguments.get("seconds", _WAIT_SECONDS)
        if self._goals.knows(handle):
            await _within(seconds, self._goals.find(handle).done)
        else:
            approval = self._desk.find(handle, self.guest.principal)
            if approval is not None and approval.phase is ApprovalPhase.PENDING:
                event = self._decided.setdefault(handle, asyncio.Event())
                try:
                    await _within(seconds, event)
                finally:
                    self._decided.pop(handle, None)
        return await self._goal_status(arguments)

    async def _cancel(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        goal = self._goals.find(arguments["handle"])
        if not goal.done.is_set():
            asked = await self._backend.in_worker(lambda: self._goals.cancel(goal))
            if not asked:
                return {
                    **goal.facts(),
                    "next": f"{goal.function} cannot be cancelled; its end is reported still",
                }
            await _within(_AT_ONCE_SECONDS, goal.done)
        return goal.facts()

    async def _found(self, function: str) -> tuple[Plan, int]:
        """Return the plan of a function, and the revision that it is of at the latest."""
        revision = self._backend.robot.revision
        plan = await self._backend.resolve(function)
        return plan, revision


def _checked(plan: Plan, made: FunctionTool, arguments: Mapping[str, Any]) -> tuple[Message, str]:
    """Return the message of a tool's arguments and the approval, where the message fits."""
    message, handle = tool_arguments(_structure(plan, made)).split(arguments)
    _check(plan, made, message)
    return message, handle


def _check(plan: Plan, made: FunctionTool, message: Message) -> None:
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


@cache
def _own_validator(name: str) -> Draft202012Validator:
    return Draft202012Validator(OWN_INPUTS[name])


def _validator_of(made: FunctionTool) -> Draft202012Validator:
    return Draft202012Validator(made.tool.input_schema)


def _check_own(name: str, arguments: Mapping[str, Any]) -> None:
    problem = best_match(_own_validator(name).iter_errors(arguments))
    if problem is not None:
        raise MessageError(_problem_text(problem))


def _problem_text(problem: Any) -> str:
    path = ".".join(map(str, problem.absolute_path)) or "arguments"
    return f"{path}: {problem.message:.300}"


async def _within(seconds: float, event: asyncio.Event) -> None:
    if event.is_set():
        return
    with contextlib.suppress(asyncio.TimeoutError):
        await asyncio.wait_for(event.wait(), seconds)


def _succeeded(
    facts: dict[str, Any],
    links: Any = (),
    pictures: Any = (),
    *,
    is_error: bool = False,
) -> CallToolResult:
    text = orjson.dumps(facts, option=orjson.OPT_NON_STR_KEYS).decode()
    content: list[TextContent | ResourceLink | ImageContent] = [TextContent(text=text)]
    return CallToolResult(
        content=[*content, *links, *pictures], structured_content=facts, is_error=is_error
    )


def _failed(code: str, text: str) -> CallToolResult:
    return CallToolResult(content=[TextContent(text=f"{code}: {text}")], is_error=True)
