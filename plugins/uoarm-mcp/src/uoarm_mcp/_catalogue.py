"""Which tools and resources a role has: names, schemas, hints, and why one is left out."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Iterator, Mapping
from enum import Enum
from functools import partial

from attrs import field, frozen
from mcp_types import Resource, Tool, ToolAnnotations

from uoarm.model import Function, MessageStructure, Plan, Robot
from uoarm.schema import property_of
from uoarm.server.front_end import AccessRole, Backend, Operation, coded_text, is_action
from uoarm_mcp._schemas import (
    OWN_INPUTS,
    has_headers,
    output_schema,
    read_input,
    read_output,
    tool_arguments,
)

STREAM = "uoarm://stream/"
_FIND_SECONDS = 10.0
OWN: Mapping[str, str] = {
    "plan": """Say what a request would open and why, or why not, with the counterexample and what
would fit nearly. With arguments: check them, and ask for the approval that doing it needs; the
handle is that of the plan, of its approval and of doing it. Nothing is opened or moved.""",
    "status": """Say how the robot is: functions, components, connections, what is held, one's goals
and approvals, and which tools are left out and why.""",
    "explain_failure": "Say why a function cannot be had or has failed, or how a goal ended.",
    "discover": "List what the robot's frameworks have now, configured or not.",
    "stop": "Stop what moves: everything, where one may; else all that one has moved oneself.",
    "goal_status": "Say how a goal or an approval stands; does not wait.",
    "wait": "Wait for the end of a goal, or for the decision about an approval, shortly.",
    "cancel": "Cancel a goal.",
}
_ACTING = frozenset({"stop", "cancel"})


class ToolKind(Enum):
    """What a tool does with a function."""

    CALL = "call"
    GOAL = "goal"
    SEND = "send"
    READ = "read"


_OPERATIONS = {
    ToolKind.CALL: Operation.CALL,
    ToolKind.GOAL: Operation.SEND,
    ToolKind.SEND: Operation.SEND,
    ToolKind.READ: Operation.REQUEST,
}

_DOES = {
    ToolKind.CALL: "Calls",
    ToolKind.GOAL: "Gives a goal, which has a handle, to",
    ToolKind.SEND: "Sends one message to",
}


@frozen
class FunctionTool:
    """A tool that is made of a function.

    Attributes:
        kind: what it does with it.
        port: the input that it sends to, the first output that it reads; empty: the only one.
        outputs: those that it can read.
        needs: why it needs an approval; empty: it needs none.
        tool: as it is listed.
        is_headed: whether a client repeats arguments of it in headers.
    """

    function: str
    kind: ToolKind
    port: str
    outputs: tuple[str, ...]
    needs: str
    tool: Tool
    is_headed: bool = False

    @property
    def operation(self) -> Operation:
        """The right that it takes."""
        return _OPERATIONS[self.kind]


@frozen
class Catalogue:
    """What a role has.

    Attributes:
        tools: of functions, by name.
        own: tools that every robot has.
        resources: streams, by address.
        outputs: of each of these what is read, FUNCTION.OUTPUT.
        headed: names of the tools of which a client repeats arguments in headers.
        left_out: what has no tool, and why.
    """

    tools: Mapping[str, FunctionTool] = field(factory=dict)
    own: tuple[Tool, ...] = ()
    resources: Mapping[str, Resource] = field(factory=dict)
    outputs: Mapping[str, str] = field(factory=dict)
    left_out: Mapping[str, str] = field(factory=dict)
    headed: frozenset[str] = frozenset()


@frozen(eq=False)
class _FunctionListing:
    """What one function has with a plan, whatever the role."""

    plan: Plan
    tools: tuple[FunctionTool, ...]
    resources: Mapping[str, Resource]
    outputs: Mapping[str, str]


def uri_of(function: str, output: str) -> str:
    """Return the address of a stream."""
    return f"{STREAM}{function}" if not output else f"{STREAM}{function}/{output}"


class CatalogueMaker:
    """Makes the catalogue of each role, once for each configuration; in the server's loop.

    Args:
        found: called when a plan is found that a catalogue did not wait for.
    """

    def __init__(self, backend: Backend, found: Callable[[], None]) -> None:
        self._backend = backend
        self._found = found
        self._robot: Robot | None = None
        self._searches: dict[str, asyncio.Task[Plan]] = {}
        # What did not come within the limit, as behind a bridge that hangs: it is not waited for
        # again, so that the calls of other functions have it once.
        self._late: set[str] = set()
        # Made anew with another plan only: while one function has none, every call makes a
        # catalogue.
        self._listings: dict[str, _FunctionListing] = {}
        self._made: dict[AccessRole, Catalogue] = {}
        self._making: dict[AccessRole, asyncio.Task[Catalogue]] = {}

    def forget(self, function: str = "") -> None:
        """Look again at what could not be had, and at a function: the robot has changed."""
        self._drop()
        self._searches.pop(function, None)  # another component may provide it now

    def _drop(self) -> None:
        # What is being made is of what was before: it is not kept, and no one else waits for it.
        self._made, self._making = {}, {}

    def known(self, role: AccessRole) -> Catalogue | None:
        """Return the catalogue of a role, where it is made; without waiting."""
        return None if self._backend.robot.config is not self._robot else self._made.get(role)

    async def of(self, role: AccessRole) -> Catalogue:
        """Return the catalogue of a role."""
        robot = self._backend.robot.config
        if self._robot is not robot:
            self._robot = robot
            self._searches.clear()
            self._late.clear()
            self._listings.clear()
            self._drop()
        made = self._made.get(role)
        if made is not None:
            return made
        making = self._making.get(role)
        if making is None:
            making = self._making[role] = asyncio.ensure_future(self._make(robot, role))
            making.add_done_callback(partial(_take_out, self._making, role))
        return await asyncio.shield(making)

    async def _make(self, robot: Robot, role: AccessRole) -> Catalogue:
        view, kept = self._backend.role_views.of(role), self._made
        visible = [name for name in robot.functions if view.has_function(name)]
        searches = await self._search(visible)
        tools: dict[str, FunctionTool] = {}
        resources: dict[str, Resource] = {}
        outputs: dict[str, str] = {}
        left_out: dict[str, str] = {}
        for name in visible:
            plan = _result(searches[name])
            if isinstance(plan, str):
                left_out[name] = view.text(plan, name)
                continue
            listing = self._listing(robot.functions[name], plan)
            await asyncio.sleep(0)  # each takes a millisecond, and there may be thousands
            for made in listing.tools:
                if not role.allows(made.operation, name):
                    left_out[made.tool.name] = f"the role may not {made.operation.value} {name}"
                elif made.tool.name in tools or made.tool.name in OWN:
                    left_out[f"{made.tool.name} of {name}"] = "another tool has its name"
                else:
                    tools[made.tool.name] = made
            if role.allows(Operation.REQUEST, name):
                resources |= listing.resources
                outputs |= listing.outputs
        headed = frozenset(name for name, made in tools.items() if made.is_headed)
        catalogue = Catalogue(tools, _own_tools(role), resources, outputs, left_out, headed)
        if not left_out.keys() & set(visible):
            kept[role] = catalogue
        return catalogue

    async def _search(self, names: Iterable[str]) -> Mapping[str, asyncio.Task[Plan]]:
        """Return the search for the plan of each function; what had failed is sought again."""
        searches = {}
        for name in names:
            search = self._searches.get(name)
            if search is None or (search.done() and isinstance(_result(search), str)):
                begun = self._searches[name] = asyncio.ensure_future(self._backend.resolve(name))
                begun.add_done_callback(partial(self._end, name))
                if search is None or name not in self._late:  # else it shows why it failed last
                    search = begun
            searches[name] = search
        waited = [search for name, search in searches.items() if name not in self._late]
        if waited:
            await asyncio.wait(waited, timeout=_FIND_SECONDS)
        self._late |= {name for name, search in searches.items() if not search.done()}
        return searches

    def _end(self, name: str, search: asyncio.Task[Plan]) -> None:
        is_found = not isinstance(_result(search), str)
        if is_found and name in self._late and self._searches.get(name) is search:
            self._late.discard(name)
            self._found()

    def _listing(self, function: Function, plan: Plan) -> _FunctionListing:
        known = self._listings.get(function.name)
        if known is None or known.plan is not plan:
            resources, outputs = self._resources(function, plan)
            known = _FunctionListing(plan, tuple(self._tools(function, plan)), resources, outputs)
            self._listings[function.name] = known
        return known

    def _tools(self, function: Function, plan: Plan) -> Iterator[FunctionTool]:
        component, structures = plan.provider.component, plan.provider.structures
        if component.service is not None:
            yield self._acting(
                function, ToolKind.CALL, "", structures["request"], structures["reply"]
            )
        own = [port.name for port in component.inputs if port.source is None]
        is_only = len(own) == 1
        if is_action(component):
            # Goals and cancellations are sent by this tool and by `cancel`, and in no other way.
            yield self._acting(
                function,
                ToolKind.GOAL,
                "goal",
                structures["input.goal"],
                MessageStructure(property_of(structures["output.result"].schema, "result")),
            )
            own = [name for name in own if name not in {"goal", "cancel"}]
        for name in own:
            port = "" if is_only else name
            yield self._acting(function, ToolKind.SEND, port, structures[f"input.{name}"], None)
        outputs = tuple(output.name for output in component.outputs)
        if outputs:
            yield self._reading(function, outputs, structures[f"output.{outputs[0]}"])

    def _acting(
        self,
        function: Function,
        kind: ToolKind,
        port: str,
        taken: MessageStructure,
        given: MessageStructure | None,
    ) -> FunctionTool:
        name = f"send_{function.name}" if kind is ToolKind.SEND else function.name
        if port and kind is ToolKind.SEND:
            name += f".{port}"
        if name in OWN:
            name = f"call_{name}"
        needs = self._needs(_OPERATIONS[kind], function.name)
        what = _DOES[kind]
        hints = ToolAnnotations(
            read_only_hint=False,
            destructive_hint=bool(needs),
            idempotent_hint=False,
            open_world_hint=False,
        )
        schema = tool_arguments(taken).schema
        tool = Tool(
            name=name,
            description=_described(function, what, needs),
            input_schema=schema,
            output_schema=output_schema(given),
            annotations=hints,
        )
        return FunctionTool(function.name, kind, port, (), needs, tool, has_headers(schema))

    def _reading(
        self, function: Function, outputs: tuple[str, ...], structure: MessageStructure
    ) -> FunctionTool:
        needs = self._needs(Operation.REQUEST, function.name)
        tool = Tool(
            name=f"read_{function.name}",
            description=_described(function, "Reads messages of", needs),
            input_schema=read_input(outputs),
            output_schema=read_output(structure if len(outputs) == 1 else MessageStructure({})),
            annotations=ToolAnnotations(
                read_only_hint=not needs,
                destructive_hint=bool(needs),
                idempotent_hint=True,
                open_world_hint=False,
            ),
        )
        return FunctionTool(function.name, ToolKind.READ, outputs[0], outputs, needs, tool)

    def _resources(
        self, function: Function, plan: Plan
    ) -> tuple[dict[str, Resource], dict[str, str]]:
        made: dict[str, Resource] = {}
        outputs: dict[str, str] = {}
        if self._needs(Operation.REQUEST, function.name):
            return made, outputs
        names = [output.name for output in plan.provider.component.outputs]
        for name in names:
            uri = uri_of(function.name, name if len(names) > 1 else "")
            outputs[uri] = f"{function.name}.{name}"
            made[uri] = Resource(
                uri=uri,
                name=uri.removeprefix(STREAM),
                description=_described(function, "The latest message of", ""),
                mime_type="application/json",
            )
        return made, outputs

    def _needs(self, operation: Operation, function: str) -> str:
        return self._backend.approvals.supervision.reason(operation, function)


def _take_out(
    making: dict[AccessRole, asyncio.Task[Catalogue]], role: AccessRole, made: object
) -> None:
    del made, making[role]


def _result(search: asyncio.Task[Plan]) -> Plan | str:
    """Return the plan that was found, or why there is none."""
    if not search.done():
        return f"no plan within {_FIND_SECONDS:g} s"
    if search.cancelled():
        return "the server is closing"
    error = search.exception()
    return search.result() if error is None else coded_text(error)


def _described(function: Function, what: str, needs: str) -> str:
    text = function.description or f"{what} {function.name}."
    if function.description:
        text = f"{text} ({what} {function.name}.)"
    if needs:
        text += (
            " Needs the approval of a person: call it to ask for one, and again with the same "
            "arguments and x-approval once it is given."
        )
    return text


def _own_tools(role: AccessRole) -> tuple[Tool, ...]:
    tools = []
    for name, description in OWN.items():
        if name == "discover" and not role.allows_all(Operation.SEE):
            continue
        hints = ToolAnnotations(
            read_only_hint=name not in _ACTING,
            destructive_hint=False,
            idempotent_hint=True,
            open_world_hint=False,
        )
        tools.append(
            Tool(
                name=name,
                description=" ".join(description.split()),
                input_schema=dict(OWN_INPUTS[name]),
                annotations=hints,
            )
        )
    return tuple(tools)
