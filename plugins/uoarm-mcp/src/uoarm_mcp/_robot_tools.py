"""The tools that every robot has: plan, status, causes, discovery, stop, and work under way."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from functools import cache, partial
from typing import Any

from attrs import define, evolve, field
from jsonschema import Draft202012Validator

from uoarm.errors import ResolutionError, UoarmError, UsageError
from uoarm.model import Message, Plan
from uoarm.server.front_end import (
    TEXT_FORM,
    Approval,
    ApprovalEnvelope,
    ApprovalPhase,
    Backend,
    Discoveries,
    Operation,
    RoleView,
    StatelessClient,
    UnknownError,
    coded_text,
    is_action,
    show_approval,
    show_plan,
    show_stop,
    visible_status,
)
from uoarm_mcp._actions import AgentActions, AgentGoals, check_arguments, within
from uoarm_mcp._catalogue import Catalogue, CatalogueMaker, FunctionTool, ToolKind
from uoarm_mcp._schemas import OWN_INPUTS, check_schema
from uoarm_mcp._streams import AgentStreams
from uoarm_mcp._values import KeptValues, render

_CANCEL_SECONDS = 5.0
_WAIT_SECONDS = 20.0
_MOST_EVENTS = 20
_MOST_SHOWN = 60_000
_KINDS = {
    "call": (ToolKind.CALL,),
    "send": (ToolKind.SEND, ToolKind.GOAL),
    "request": (ToolKind.READ,),
}


_Tool = Callable[[Mapping[str, Any]], Awaitable[dict[str, Any]]]


@define(eq=False)
class RobotTools:
    """These tools for one agent, in the server's loop."""

    _client: StatelessClient
    _backend: Backend
    _catalogues: CatalogueMaker
    _discoveries: Discoveries
    _actions: AgentActions
    _kept: KeptValues
    _streams: AgentStreams
    _goals: AgentGoals
    _decided: dict[str, asyncio.Event] = field(factory=dict, init=False)
    _tools: Mapping[str, _Tool] = field(init=False)

    def __attrs_post_init__(self) -> None:
        """Look at approvals from now on."""
        self._tools = {
            "plan": self._plan,
            "status": self._status,
            "explain_failure": self._explain,
            "discover": self._discover,
            "stop": self._stop,
            "goal_status": self._goal_status,
            "wait": self._wait,
            "cancel": self._cancel,
        }
        self._backend.approvals.watch(self._changed)

    def close(self) -> None:
        """Look at approvals no more."""
        self._backend.approvals.unwatch(self._changed)

    def __contains__(self, name: str) -> bool:
        return name in self._tools

    async def call(self, name: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        """Use one of them.

        Raises:
            MessageError: the arguments do not fit.
            UoarmError: as the tool says.
        """
        check_schema(_validator(name), arguments)
        return await self._tools[name](arguments)

    @property
    def _view(self) -> RoleView:
        return self._backend.role_views.of(self._client.role)

    async def _plan(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        name = arguments["function"].partition(".")[0]
        self._client.require(Operation.SEE, name)
        revision = self._backend.robot.revision
        try:
            plan = await self._backend.resolve(arguments["function"])
        except ResolutionError as error:
            return {
                "function": name,
                "possible": False,
                "why": self._view.text(coded_text(error), name),
                "state": "impossible",
            }
        shown = show_plan(plan, TEXT_FORM, self._view)
        facts: dict[str, Any] = {
            "function": name,
            "possible": True,
            "state": "possible",
            "opens": shown["text"][:_MOST_SHOWN],
            "components": [
                step.component.name
                for step in plan.steps
                if self._view.has_component(step.component.name)
            ],
            "warnings": shown["plan"]["warnings"],
        }
        catalogue = await self._catalogues.of(self._client.role)
        made = self._meant(catalogue, name, plan, arguments)
        if made is None:
            return facts
        facts["tool"] = made.tool.name
        reason = self._actions.reason(made)
        facts["needs_approval"] = self._view.text(reason, name)
        if "arguments" not in arguments:
            return facts
        self._client.require(made.operation, name)
        message: Message = arguments["arguments"]
        if made.kind is not ToolKind.READ:
            check_arguments(plan, made, message)
        facts["arguments"] = "they fit"
        if reason:
            given = arguments.get("envelope", {})
            envelope = ApprovalEnvelope(
                {path: (least, most) for path, (least, most) in given.get("ranges", {}).items()},
                given.get("count", 1),
                given.get("rate"),
            )
            request = evolve(
                self._actions.request(made, message, plan, revision),
                envelope=envelope,
                seconds=float(arguments.get("seconds", 60.0)),
            )
            facts |= self._actions.ask(made, request)
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
        view, role = self._view, self._client.role
        catalogue = await self._catalogues.of(self._client.role)
        status = await self._backend.in_worker(
            lambda: visible_status(self._backend.robot.status(), view)
        )
        functions = self._backend.robot.config.functions
        approvals = [
            show_approval(self._backend.approvals, approval, view)
            for approval in self._backend.approvals.asked_by(self._client.principal)
        ]
        warnings = []
        if self._client.principal == "local":
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
            "principal": self._client.principal,
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
            "open": self._streams.open,
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
        self._client.require(Operation.SEE, name)
        view = self._view
        try:
            await self._backend.resolve(name)
            why = "a plan is found now"
        except UoarmError as error:
            why = view.text(coded_text(error), name)
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
        self._client.require_all(Operation.SEE)
        found = await self._discoveries.look()
        return {"bridges": found}

    async def _stop(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        del arguments
        if not self._client.role.allows_all(Operation.STOP):
            # What moves is stopped first: bridges that are asked to cancel may take their time.
            stopped = [*self._streams.stop_own(), *self._goals.stop_own()]
            cancelled = await self._backend.in_worker(
                lambda: [goal.handle for goal in self._goals.running() if self._goals.cancel(goal)]
            )
            return {"stopped": stopped, "cancelled": cancelled}
        self._client.require_all(Operation.STOP)
        view = self._view
        report, shown = await self._backend.stop_all(
            (view.role, "mcp"), lambda report: show_stop(report, view)
        )
        self._client.note_stop(report)
        return shown

    async def _goal_status(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        handle = arguments["handle"]
        if self._goals.knows(handle):
            goal = self._goals.find(handle)
            if goal.done.is_set() or goal.feedback is None:
                return goal.facts()
            shown = goal.shown
            if shown is None or not self._kept.has(shown):
                last = goal.feedback
                shown = self._kept.keep(await self._backend.in_worker(partial(render, last)))
                if last is goal.feedback:
                    goal.shown = shown
            return {**goal.facts(), "feedback": shown.value}
        approval = self._backend.approvals.find(handle, self._client.principal)
        if approval is None:
            raise UnknownError(f"there is no goal and no approval {handle!r:.64} of this agent")
        return {
            "state": approval.phase.value,
            "handle": handle,
            "approval": show_approval(self._backend.approvals, approval, self._view),
        }

    async def _wait(self, arguments: Mapping[str, Any]) -> dict[str, Any]:
        handle, seconds = arguments["handle"], arguments.get("seconds", _WAIT_SECONDS)
        if self._goals.knows(handle):
            await within(seconds, self._goals.find(handle).done)
        else:
            approval = self._backend.approvals.find(handle, self._client.principal)
            if approval is not None and approval.phase is ApprovalPhase.PENDING:
                await within(seconds, self._decided.setdefault(handle, asyncio.Event()))
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
            await within(_CANCEL_SECONDS, goal.done)
        return goal.facts()

    def _changed(self, approval: Approval) -> None:
        if approval.phase is not ApprovalPhase.PENDING and approval.id in self._decided:
            self._decided.pop(approval.id).set()


@cache
def _validator(name: str) -> Draft202012Validator:
    return Draft202012Validator(OWN_INPUTS[name])
