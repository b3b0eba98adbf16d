"""One agent: its tools, and what it reads of streams."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

from jsonschema import Draft202012Validator
from mcp_types import CallToolResult, ImageContent, Tool

from uoarm.errors import UoarmError, UsageError
from uoarm.model import LeaseHolder
from uoarm.server.front_end import (
    TEXT_FORM,
    Backend,
    Discoveries,
    LimitError,
    Operation,
    RoleView,
    StatelessClient,
    UnknownError,
)
from uoarm_mcp._actions import AgentActions, AgentGoals
from uoarm_mcp._catalogue import STREAM, Catalogue, CatalogueMaker, FunctionTool, ToolKind
from uoarm_mcp._robot_tools import RobotTools
from uoarm_mcp._schemas import APPROVAL, check_schema
from uoarm_mcp._streams import AgentStreams
from uoarm_mcp._values import KeptValues, failed, failure_text, is_picture, picture_of, succeeded

__all__ = ["Agent"]

_READ_SECONDS = 5.0


class Agent:
    """All requests of one client, in the server's loop.

    Args:
        client: whose.
        backend: the robot.
        catalogues: what roles have.
        discoveries: what bridges see.
    """

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
        catalogue = await self.catalogue()
        if name not in self._robot_tools and name not in catalogue.tools:
            known = catalogue.left_out.get(name, "")
            raise UnknownError(f"there is no tool {name!r:.200}{known and f': {known}'}")
        if self._under_way >= self.client.limits.calls:
            refusal = LimitError(f"{self._under_way} calls are under way; wait for one of them")
            return failed(failure_text(refusal))
        self._under_way += 1
        try:
            if name in self._robot_tools:
                return succeeded(await self._robot_tools.call(name, arguments))
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
        return succeeded(facts, [link for item in rendered for link in item.links], pictures)

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
        self.client.require(Operation.REQUEST, function)
        if not output:
            made = catalogue.tools.get(f"read_{function}")
            output = made.outputs[0] if made is not None else "default"
        return function, output
