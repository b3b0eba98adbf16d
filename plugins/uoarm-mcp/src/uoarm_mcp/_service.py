"""The protocol: its methods on what agents have, for every revision that the SDK speaks.

An agent has its tools, and what it reads of streams.
"""

from __future__ import annotations

import asyncio
import base64
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from functools import partial
from typing import Any, TypeVar

from jsonschema import Draft202012Validator
from mcp.server.connection import Connection
from mcp.server.context import ServerRequestContext
from mcp.server.lowlevel import Server as ProtocolServer
from mcp.server.subscriptions import (
    InMemorySubscriptionBus,
    ListenHandler,
    ResourcesListChanged,
    ResourceUpdated,
    ToolsListChanged,
)
from mcp.shared.exceptions import MCPError
from mcp_types import (
    INVALID_PARAMS,
    BlobResourceContents,
    CallToolRequestParams,
    CallToolResult,
    EmptyResult,
    ImageContent,
    ListResourcesResult,
    ListResourceTemplatesResult,
    ListToolsResult,
    PaginatedRequestParams,
    ReadResourceRequestParams,
    ReadResourceResult,
    Resource,
    ResourceTemplate,
    SubscribeRequestParams,
    SubscriptionsListenRequestParams,
    SubscriptionsListenResult,
    TextResourceContents,
    Tool,
    UnsubscribeRequestParams,
)

from uoarm.errors import UoarmError, UsageError
from uoarm.model import LeaseHolder
from uoarm.server.front_end import (
    TEXT_FORM,
    Backend,
    ChangeNotice,
    Discoveries,
    LimitError,
    Operation,
    RoleView,
    StatelessClient,
    UnknownError,
    coded_text,
)
from uoarm_mcp._actions import AgentActions, AgentGoals
from uoarm_mcp._catalogue import OWN, STREAM, Catalogue, CatalogueMaker, FunctionTool, ToolKind
from uoarm_mcp._robot_tools import RobotTools
from uoarm_mcp._schemas import APPROVAL, check_schema
from uoarm_mcp._streams import AGAIN_SECONDS, AgentStreams
from uoarm_mcp._values import (
    KEPT,
    KeptValues,
    failed,
    failure_text,
    is_picture,
    picture_of,
    render,
    succeeded,
)

_READ_SECONDS = 5.0
CLIENT = "uoarm.client"
_INSTRUCTIONS = (
    "The functions of a robot. What moves something needs the approval of a person: call the tool "
    "to ask for it, `wait` for the decision, and call it again with x-approval. Work that lasts "
    "returns a handle at once: use wait, goal_status and cancel. status says which tools are left "
    "out and why; plan says what a request would do before it does it; stop stops."
)
_NOTICE_SECONDS = 0.2
_PAGE = 250
_MOST_LISTENING = 16
_MOST_SUBSCRIBED = 64
_SUBSCRIBES = "uoarm.subscribes"
_ALWAYS = frozenset({"stop", "cancel"})  # however many calls are under way
_Item = TypeVar("_Item")
_Context = ServerRequestContext[Any, Any]
_client: ContextVar[StatelessClient | None] = ContextVar("uoarm_mcp_guest", default=None)


def _connection(context: _Context) -> Connection:
    """Return what a session is from its first request to its end; `session` is of one request."""
    return context.session._connection  # noqa: SLF001 - the SDK has no other way to its `exit_stack`


def _page(
    items: list[_Item], names: list[str], params: PaginatedRequestParams | None
) -> tuple[list[_Item], str | None]:
    """Return one page of a list, and the cursor of the next one: the last name of this one.

    Long, since there are clients that ask for the first page only; not longer, since the SDK writes
    an answer in the loop.
    """
    begin = 0
    if params is not None and params.cursor is not None:
        if params.cursor not in names:
            raise MCPError(INVALID_PARAMS, f"cursor: there is no {params.cursor!r:.200}; list anew")
        begin = names.index(params.cursor) + 1
    end = begin + _PAGE
    return items[begin:end], names[end - 1] if end < len(items) else None


class Agent:
    """All requests of one client, in the server's loop."""

    def __init__(
        self,
        client: StatelessClient,
        backend: Backend,
        catalogues: CatalogueMaker,
        discoveries: Discoveries,
    ) -> None:
        self.client = client
        self.kept = KeptValues(client.account)
        self._backend = backend
        self._catalogues = catalogues
        holder = LeaseHolder(f"agent {client.principal} {client.identity}", client.role.name)
        self.streams = AgentStreams(backend, client.account, holder)
        self._goals = AgentGoals()
        self._actions = AgentActions(client, backend, self.kept, self.streams, self._goals)
        self._robot_tools = RobotTools(
            client,
            backend,
            catalogues,
            discoveries,
            self._actions,
            self.kept,
            self.streams,
            self._goals,
        )
        self._under_way = 0

    @property
    def view(self) -> RoleView:
        """What its role sees."""
        return self._backend.role_views.of(self.client.role)

    def close(self) -> None:
        """Let go of everything: what it moved is stopped."""
        self._robot_tools.close()
        self._goals.close()
        self.streams.close()

    async def catalogue(self) -> Catalogue:
        """Return what it has."""
        return await self._catalogues.of(self.client.role)

    async def tools(self) -> list[Tool]:
        """Return its tools."""
        catalogue = await self.catalogue()
        return [*catalogue.own, *(made.tool for made in catalogue.tools.values())]

    async def call(self, name: str, arguments: Mapping[str, Any]) -> CallToolResult:
        """Use a tool; what goes wrong is in the result.

        Raises:
            UnknownError: there is no such tool for this role.
        """
        if name not in self._robot_tools:  # to stop is not to wait for what a catalogue waits for
            catalogue = await self.catalogue()
            if name not in catalogue.tools:
                known = catalogue.left_out.get(name, "")
                raise UnknownError(f"there is no tool {name!r:.200}{known and f': {known}'}")
        try:
            with self.working(is_refused=name not in _ALWAYS):
                if name in self._robot_tools:
                    facts = await self._robot_tools.call(name, arguments)
                    return succeeded(facts, self._goals.links(arguments.get("handle", "")))
                made = catalogue.tools[name]
                self.client.require(made.operation, made.function)
                if made.kind is ToolKind.READ:
                    return await self._read_stream(made, arguments)
                return await self._actions.act(made, arguments)
        except UoarmError as error:
            if isinstance(error, UnknownError) and name not in self._robot_tools:
                raise
            return failed(self.view.text(failure_text(error), str(arguments)))
        except Exception as error:  # noqa: BLE001 - the agent gets an answer, the log the cause
            return failed(failure_text(error))

    @contextmanager
    def working(self, *, is_refused: bool = True) -> Iterator[None]:
        """Count what a request does as under way.

        Raises:
            LimitError: as many as may are, unless it is never refused.
        """
        if is_refused and self._under_way >= self.client.limits.calls:
            raise LimitError(f"{self._under_way} calls are under way; wait for one of them")
        self._under_way += 1
        try:
            yield
        finally:
            self._under_way -= 1

    async def _read_stream(
        self, made: FunctionTool, arguments: Mapping[str, Any]
    ) -> CallToolResult:
        check_schema(Draft202012Validator(made.tool.input_schema), arguments)
        options = dict(arguments)
        handle = options.pop(APPROVAL, "")
        output = options.get("output", made.outputs[0])
        check = None
        if self._actions.reason(made):
            plan, revision = await self._actions.find_plan(made.function)
            request = self._actions.request(made, options, plan, revision)
            if not handle:
                facts = self._actions.ask(made, request)
                return succeeded({"messages": [], **facts})
            self._backend.approvals.use(handle, request)
            check = partial(self._actions.check_foundation, made, request)
        collector, end = await self.streams.read(
            f"{made.function}.{output}",
            options.get("count", 1),
            options.get("seconds", _READ_SECONDS),
            latest=options.get("latest", True),
            check=check,
        )
        messages = collector.messages
        pictures: list[ImageContent] = []
        if options.get("picture"):
            pictures = [
                await self._backend.in_worker(partial(picture_of, message))
                for message in messages[:4]
                if is_picture(message)
            ]
        made_of = await self._backend.in_worker(lambda: [render(message) for message in messages])
        rendered = [self.kept.keep(item) for item in made_of]
        facts = {
            "messages": [item.value for item in rendered if not item.is_summary],
            "lost": collector.lost,
        }
        summaries = [item.value for item in rendered if item.is_summary]
        if summaries:
            facts["summaries"] = summaries
        if end:
            facts["ended"] = self.view.text(end, made.function)
        return succeeded(facts, [link for item in rendered for link in item.links], pictures)

    async def latest(self, uri: str) -> tuple[str, bytes]:
        """Return the newest message of a stream as a resource: its kind and octets.

        Raises:
            UnknownError: the role has no such stream.
        """
        name = await self.stream_of(uri)
        collector, end = await self.streams.read(name, 1, _READ_SECONDS, latest=True)
        if not collector.messages:
            raise UsageError(
                f"no message of {name} came in {_READ_SECONDS:g} s{end and f'; {end}'}"
            )
        message = collector.messages[0]
        if isinstance(message, Mapping) and is_picture(message):
            return "application/octet-stream", bytes(message["data"])
        text = await self._backend.in_worker(lambda: TEXT_FORM.write(message))
        return "application/json", text

    async def stream_of(self, uri: str) -> str:
        """Return what a stream's address stands for, FUNCTION.OUTPUT; raises UnknownError."""
        catalogue = await self.catalogue()
        if uri not in catalogue.resources:
            raise UnknownError(f"there is no resource {uri!r:.200}")
        name = catalogue.outputs[uri]
        self.client.require(Operation.REQUEST, name.partition(".")[0])
        return name


class AgentService:
    """The agents of one server, and the protocol that all of them speak.

    Args:
        local: the client of requests that come without HTTP; None: there are none.
    """

    def __init__(
        self,
        backend: Backend,
        discoveries: Discoveries,
        version: str,
        local: StatelessClient | None = None,
    ) -> None:
        self._backend = backend
        self._discoveries = discoveries
        self._local = local
        self._catalogues = CatalogueMaker(backend, self._publish)
        self._agents: dict[StatelessClient, Agent] = {}
        self._listening: dict[StatelessClient, int] = {}
        self._buses: dict[InMemorySubscriptionBus, None] = {}
        self._publishing: set[asyncio.Task[None]] = set()
        self._subscribed: dict[tuple[StatelessClient, Connection, str], Callable[[], None]] = {}
        self.protocol: ProtocolServer[Any] = ProtocolServer(
            "uoarm",
            version=version,
            title="uoarm",
            instructions=_INSTRUCTIONS,
            on_list_tools=self._list_tools,
            on_call_tool=self._call_tool,
            on_list_resources=self._list_resources,
            on_list_resource_templates=self._list_templates,
            on_read_resource=self._read_resource,
            on_subscribe_resource=self._subscribe,
            on_unsubscribe_resource=self._unsubscribe,
            on_subscriptions_listen=self._listen,
            get_tool_input_schema=self._headed_schema,
        )
        backend.watch(self._changed)

    def close(self) -> None:
        """Let go of everything."""
        self._backend.unwatch(self._changed)
        for end in self._subscribed.values():
            end()
        self._subscribed.clear()
        for agent in self._agents.values():
            agent.close()
        self._agents.clear()

    async def prepare(self, client: StatelessClient, tool: str) -> None:
        """Have ready what a call of a tool needs at once; call it in the request's task."""
        _client.set(client)
        if tool not in OWN:
            await self._catalogues.of(client.role)

    def _headed_schema(self, name: str) -> Mapping[str, Any] | None:
        """Return the schema of a tool whose arguments are repeated in headers; None: they are not.

        Without this the SDK lists all tools before each call to look for such fields.
        """
        client = _client.get()
        catalogue = None if client is None else self._catalogues.known(client.role)
        if catalogue is None or name not in catalogue.headed:
            return None
        return catalogue.tools[name].tool.input_schema

    def _agent(self, context: _Context) -> Agent:
        client = self._local
        if context.request is not None:
            client = context.request.scope.get(CLIENT)
        if client is None or client.has_ended:
            raise MCPError(INVALID_PARAMS, "the rights of this client have ended")
        client.act()
        agent = self._agents.get(client)
        if agent is None:
            agent = self._agents[client] = Agent(
                client, self._backend, self._catalogues, self._discoveries
            )
            client.on_end(lambda: self._forget(client))
        return agent

    def _forget(self, client: StatelessClient) -> None:
        self._end_subscriptions(client)
        agent = self._agents.pop(client, None)
        if agent is not None:
            agent.close()

    async def _list_tools(
        self, context: _Context, params: PaginatedRequestParams | None
    ) -> ListToolsResult:
        tools = await self._agent(context).tools()
        page, cursor = _page(tools, [tool.name for tool in tools], params)
        return ListToolsResult(tools=page, next_cursor=cursor)

    async def _call_tool(self, context: _Context, params: CallToolRequestParams) -> CallToolResult:
        try:
            return await self._agent(context).call(params.name, params.arguments or {})
        except UnknownError as error:
            raise MCPError(INVALID_PARAMS, coded_text(error)) from None

    async def _list_resources(
        self, context: _Context, params: PaginatedRequestParams | None
    ) -> ListResourcesResult:
        agent = self._agent(context)
        catalogue = await agent.catalogue()
        kept = [
            Resource(uri=uri, name=uri.removeprefix(KEPT), mime_type=kind, size=size)
            for uri, kind, size in agent.kept.uris()
        ]
        resources = [*catalogue.resources.values(), *kept]
        page, cursor = _page(resources, [resource.uri for resource in resources], params)
        return ListResourcesResult(resources=page, next_cursor=cursor)

    async def _list_templates(
        self, context: _Context, params: PaginatedRequestParams | None
    ) -> ListResourceTemplatesResult:
        del params
        self._agent(context)
        several = " with several outputs"
        return ListResourceTemplatesResult(
            resource_templates=[
                ResourceTemplate(
                    uri_template=f"{STREAM}{{function}}{more}",
                    name="output" if more else "stream",
                    description=f"The latest message of a function{several if more else ''}.",
                    mime_type="application/json",
                )
                for more in ("", "/{output}")
            ]
        )

    async def _read_resource(
        self, context: _Context, params: ReadResourceRequestParams
    ) -> ReadResourceResult:
        agent, uri = self._agent(context), str(params.uri)
        found = agent.kept.find(uri)
        try:
            with agent.working():
                kind, octets = found or await agent.latest(uri)
        except UoarmError as error:
            text = agent.view.text(failure_text(error), uri)
            raise MCPError(INVALID_PARAMS, text, {"uri": uri}) from None
        if kind == "application/json":
            text_part = TextResourceContents(uri=uri, mime_type=kind, text=octets.decode())
            return ReadResourceResult(contents=[text_part])
        blob = base64.b64encode(octets).decode()
        return ReadResourceResult(
            contents=[BlobResourceContents(uri=uri, mime_type=kind, blob=blob)]
        )

    async def _subscribe(self, context: _Context, params: SubscribeRequestParams) -> EmptyResult:
        agent, uri, session = self._agent(context), str(params.uri), context.session
        connection = _connection(context)
        key = agent.client, connection, uri
        if key in self._subscribed:
            return EmptyResult()
        if (
            len([known for known in self._subscribed if known[0] is agent.client])
            >= _MOST_SUBSCRIBED
        ):
            raise MCPError(INVALID_PARAMS, f"limit: {_MOST_SUBSCRIBED} resources are watched")

        async def send() -> None:
            with suppress(Exception):  # what its transport raises where it is gone
                await session.send_resource_updated(uri)

        try:
            with agent.working():
                end = await self._watch(agent, uri, send)
        except UoarmError as error:
            raise MCPError(INVALID_PARAMS, failure_text(error)) from None
        if key in self._subscribed:  # it was asked for twice at one time
            end()
            return EmptyResult()
        self._subscribed[key] = end
        if _SUBSCRIBES not in connection.state:
            connection.state[_SUBSCRIBES] = True
            connection.exit_stack.callback(self._end_subscriptions, connection)
        return EmptyResult()

    async def _unsubscribe(
        self, context: _Context, params: UnsubscribeRequestParams
    ) -> EmptyResult:
        key = self._agent(context).client, _connection(context), str(params.uri)
        end = self._subscribed.pop(key, None)
        if end is not None:
            end()
        return EmptyResult()

    def _end_subscriptions(self, owner: StatelessClient | Connection) -> None:
        for key in [key for key in self._subscribed if owner in key[:2]]:
            self._subscribed.pop(key)()

    async def _listen(
        self, context: _Context, params: SubscriptionsListenRequestParams
    ) -> SubscriptionsListenResult:
        """Serve one stream of notices; what the role may not have is not watched."""
        agent = self._agent(context)
        client = agent.client
        if self._listening.get(client, 0) >= _MOST_LISTENING:
            raise MCPError(INVALID_PARAMS, f"limit: {_MOST_LISTENING} streams of notices are open")
        wanted = [str(uri) for uri in params.notifications.resource_subscriptions or ()]
        if len(wanted) > _MOST_SUBSCRIBED:
            raise MCPError(INVALID_PARAMS, f"limit: {_MOST_SUBSCRIBED} resources are watched")
        self._listening[client] = self._listening.get(client, 0) + 1
        bus = InMemorySubscriptionBus()
        ends: list[Callable[[], None]] = []
        opening = asyncio.ensure_future(self._watch_all(agent, wanted, bus, ends))
        self._buses[bus] = None
        try:
            return await ListenHandler(bus, max_subscriptions=1)(context, params)
        finally:
            opening.cancel()
            del self._buses[bus]
            for end in ends:
                end()
            self._listening[client] -= 1
            if not self._listening[client]:
                del self._listening[client]

    async def _watch_all(
        self,
        agent: Agent,
        uris: list[str],
        bus: InMemorySubscriptionBus,
        ends: list[Callable[[], None]],
    ) -> None:
        """Watch each of them as soon as it can be had."""

        async def send(uri: str) -> None:
            await bus.publish(ResourceUpdated(uri=uri))

        missing = dict.fromkeys(uris)
        while True:
            known = (await agent.catalogue()).resources  # once: of many none may be there
            for uri in [uri for uri in missing if uri in known]:
                with suppress(UoarmError):
                    ends.append(await self._watch(agent, uri, partial(send, uri)))
                    del missing[uri]
            if not missing:
                return
            await asyncio.sleep(AGAIN_SECONDS)

    async def _watch(self, agent: Agent, uri: str, send: Callable[[], Any]) -> Callable[[], None]:
        """Have a notice sent after each message, several a second at most."""
        if not uri.startswith(STREAM):
            raise UnknownError(f"there is no resource {uri!r:.200}")
        name = await agent.stream_of(uri)
        loop = asyncio.get_running_loop()
        last, timer = float("-inf"), None
        sending, is_due = None, False

        def fire() -> None:
            nonlocal last, timer, sending
            last, timer = time.monotonic(), None
            sending = asyncio.ensure_future(send())
            sending.add_done_callback(sent)

        def sent(_: object) -> None:
            nonlocal sending, is_due
            sending = None
            if is_due:
                is_due = False
                notify()

        def notify() -> None:
            nonlocal timer, is_due
            if sending is not None:
                is_due = True  # a client that does not read has one notice under way, not all
            elif timer is None:
                pause = max(0.0, last + _NOTICE_SECONDS - time.monotonic())
                timer = loop.call_later(pause, fire)

        stop = await agent.streams.watch(name, notify)

        def end() -> None:
            nonlocal is_due
            is_due = False
            if timer is not None:
                timer.cancel()
            if sending is not None:
                sending.cancel()
            stop()

        return end

    def _changed(self, notice: ChangeNotice) -> None:
        if not notice.event.subject.startswith("connection "):
            self._catalogues.forget(notice.event.function)
            self._publish()

    def _publish(self) -> None:
        """Have every client that listens know that there may be other tools and resources."""
        for bus in self._buses:
            for event in (ToolsListChanged(), ResourcesListChanged()):
                task = asyncio.ensure_future(bus.publish(event))
                self._publishing.add(task)
                task.add_done_callback(self._publishing.discard)
