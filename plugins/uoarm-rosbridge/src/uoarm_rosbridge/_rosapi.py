"""The services of rosapi, through which web clients look around.

What is asked of the whole robot is answered beside the loop, once for all clients of a role that
ask the same.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection, Mapping
from typing import Any, TypeAlias

import orjson

from uoarm import __version__
from uoarm.errors import UoarmError
from uoarm.model import Message, MessageStructure, Robot
from uoarm.server.front_end import Backend, Client, Operation, UnknownError
from uoarm_rosbridge._hub import Hub
from uoarm_rosbridge._names import find_place
from uoarm_rosbridge._rosapi_answers import (
    OWN,
    ListedFunction,
    Question,
    RosapiAnswers,
    arguments_by_name,
    question,
    text_of,
)
from uoarm_rosbridge._wire import clock_now

Arguments: TypeAlias = Mapping[str, Any]
_ABSENT = "null"
_FRESH_SECONDS = 0.25
_PARTLY_SECONDS = 0.02
_MOST_TYPES = 20_000  # clients may publish half as many topics, each of a type of its own


class RosapiCatalogue:
    """What rosapi answers of the whole robot, for all clients of one server."""

    def __init__(self, backend: Backend, hub: Hub) -> None:
        self._backend = backend
        self._hub = hub
        self._robot: Robot | None = None
        self._fresh_until = float("-inf")
        self._looking: asyncio.Task[None] | None = None
        self._structures: Mapping[str, Mapping[str, MessageStructure]] = {}
        self._types: dict[str, MessageStructure | None] = {}
        self._listed: dict[str, ListedFunction] = {}

    async def answer(self, asked: Question) -> bytes:
        """Return the values of an answer, as they are written.

        Raises:
            UnknownError: there is no such service, type or node.
            UsageError: an argument is missing or wrong.
        """
        while True:
            if (
                time.monotonic() > self._fresh_until
                or self._robot is not self._backend.robot.config
            ):
                if self._looking is None:
                    self._looking = asyncio.ensure_future(self._look())
                    self._looking.add_done_callback(self._looked)
                await asyncio.shield(self._looking)
            answer: bytes | frozenset[str] = await self._backend.view(self.make, asked)
            if isinstance(answer, bytes):
                return answer
            if len(self._types) + len(answer) > _MOST_TYPES:
                self._types.clear()
            for name in answer:
                self._types[name] = await self._backend.structure_of_type(name)

    def make(
        self, questions: Collection[Question]
    ) -> dict[Question, bytes | frozenset[str] | UoarmError]:
        """Return the answers to all that was asked, in the thread of the views."""
        robot, structures, former = self._robot, self._structures, self._listed
        assert robot is not None, "the robot was looked at before anything was asked"
        listed = {}
        for name, function in robot.functions.items():
            known, have = former.get(name), structures.get(name, {})
            if known is None or known.function is not function or known.structures is not have:
                known = ListedFunction(function, have)
            listed[name] = known
        self._listed = listed
        types = dict(self._types)
        answers = {
            role: RosapiAnswers(role, listed.values(), self._hub, types)
            for role in {asked.role for asked in questions}
        }
        return {asked: answers[asked.role].answer(asked) for asked in questions}

    async def _look(self) -> None:
        robot = self._backend.robot.config
        structures = await self._backend.structures(robot.functions)
        if robot is not self._robot:
            self._types = {}
        self._robot, self._structures = robot, structures
        fresh = _FRESH_SECONDS if all(structures.values()) else _PARTLY_SECONDS
        self._fresh_until = time.monotonic() + fresh

    def _looked(self, looking: asyncio.Task[None]) -> None:
        self._looking = None
        if not looking.cancelled():
            looking.exception()  # those who wait raise it


class Rosapi:
    """Answers for one client: it is shown what its role may see."""

    def __init__(self, catalogue: RosapiCatalogue, hub: Hub, client: Client) -> None:
        self._catalogue = catalogue
        self._hub = hub
        self._client = client
        self._role = client.role
        self._own: Mapping[str, Callable[[Arguments], dict[str, Any]]] = {
            name: getattr(self, f"_{name}") for name in OWN
        }

    async def call(self, name: str, arguments: Message) -> Message:
        """Answer one of the services.

        Raises:
            UnknownError: there is no such service, type or node.
            UsageError: an argument is missing or wrong.
            DeniedError: the client may not change it.
            LimitError: there is no room for it.
        """
        named = arguments_by_name(name, arguments)
        if named is None:
            raise UnknownError(f"rosapi has no service {name!r:.100}")
        own = self._own.get(name)
        if own is not None:
            return own(named)
        written = await self._catalogue.answer(question(self._role, name, named))
        await self._client.outbox.room(len(written))
        return orjson.Fragment(written)

    def _get_time(self, arguments: Arguments) -> dict[str, Any]:
        del arguments
        seconds, nanoseconds = clock_now()
        # ROS 1 clients read secs and nsecs, ROS 2 clients sec and nanosec.
        stamp = {"secs": seconds, "nsecs": nanoseconds, "sec": seconds, "nanosec": nanoseconds}
        return {"time": stamp}

    def _get_ros_version(self, arguments: Arguments) -> dict[str, Any]:
        """Say that names and messages are those of ROS 2; no distribution stands behind them."""
        del arguments
        return {"version": 2, "distro": f"uoarm {__version__}"}

    def _get_param(self, arguments: Arguments) -> dict[str, Any]:
        """Answer with JSON; what was never set has the default that the client names, or null."""
        found = self._parameter(arguments)
        if found is None:
            default = arguments.get("default_value") or arguments.get("default")
            value = default if isinstance(default, str) else _ABSENT
            return {"value": value, **_outcome(done=False)}
        return {"value": found, **_outcome(done=True)}

    def _set_param(self, arguments: Arguments) -> dict[str, Any]:
        name = self._changeable(arguments)
        owner = self._role.name, self._client.address.rpartition(":")[0]
        self._hub.parameters.set(name, text_of(arguments, "value"), owner)
        return _outcome(done=True)

    def _delete_param(self, arguments: Arguments) -> dict[str, Any]:
        return _outcome(done=self._hub.parameters.delete(self._changeable(arguments)))

    def _has_param(self, arguments: Arguments) -> dict[str, Any]:
        return {"exists": self._parameter(arguments) is not None}

    def _parameter(self, arguments: Arguments) -> str | None:
        """Return the JSON text of a parameter that is there for this client."""
        name = find_place(text_of(arguments, "name")).name
        may = self._role.allows(Operation.SEE, name)
        return self._hub.parameters.get(name) if may else None

    def _changeable(self, arguments: Arguments) -> str:
        place = find_place(text_of(arguments, "name"))
        self._client.require(Operation.SEND, place.right)
        return place.name


def _outcome(*, done: bool) -> dict[str, Any]:
    """Say how it went, in the fields of rosapi for ROS 2; that of ROS 1 has none."""
    return {"successful": done, "reason": "" if done else "there is no such parameter"}
