"""The services of rosapi that web clients use to look around."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any, TypeAlias

from uoarm import __version__
from uoarm.errors import UsageError
from uoarm.model import Component, Function, MessageStructure
from uoarm.server.front_end import Backend, Client, Operation, UnknownError
from uoarm_rosbridge._hub import Hub
from uoarm_rosbridge._names import find_place, topic_of
from uoarm_rosbridge._stream_runner import is_action
from uoarm_rosbridge._typedefs import full_text, type_name, typedefs
from uoarm_rosbridge._wire import clock_now

__all__ = ["PREFIX", "Rosapi"]

PREFIX = "/rosapi/"
Arguments: TypeAlias = Mapping[str, Any]
_ABSENT = "null"


class Rosapi:
    """Answers for one client: it is shown what its role may see. Components appear as nodes.

    No answer waits for what is not there: a topic whose type is not known yet has an empty one, and
    has it in a later answer once it can be had.
    """

    def __init__(self, backend: Backend, hub: Hub, client: Client) -> None:
        self._backend = backend
        self._hub = hub
        self._client = client
        self._role = client.role
        self._services: Mapping[str, Callable[[Arguments], Awaitable[dict[str, Any]]]] = {
            "topics": self._topics,
            "topics_and_raw_types": self._topics_and_raw_types,
            "services": self._list_services,
            "nodes": self._nodes,
            "topic_type": self._topic_type,
            "topics_for_type": self._topics_for_type,
            "service_type": self._service_type,
            "services_for_type": self._services_for_type,
            "service_node": self._service_node,
            "service_providers": self._service_providers,
            "publishers": self._publishers,
            "subscribers": self._subscribers,
            "node_details": self._node_details,
            "message_details": self._message_details,
            "service_request_details": self._request_details,
            "service_response_details": self._response_details,
            "get_time": self._get_time,
            "get_ros_version": self._get_version,
            "get_param": self._get_param,
            "set_param": self._set_param,
            "delete_param": self._delete_param,
            "get_param_names": self._param_names,
            "has_param": self._has_param,
            "action_servers": self._action_servers,
        }

    async def call(self, name: str, arguments: Arguments) -> dict[str, Any]:
        """Answer one of the services.

        Raises:
            UnknownError: there is no such service, topic, type or node.
            UsageError: an argument is missing or wrong.
            DeniedError: the client may not change it.
            LimitError: there is no room for it.
        """
        answer = self._services.get(name)
        if answer is not None:
            return await answer(arguments)
        raise UnknownError(f"rosapi has no service {name!r:.100}")

    async def _topics(self, arguments: Arguments) -> dict[str, Any]:
        del arguments
        found = {**await self._streams(), **self._visible(self._hub.topics)}
        return {"topics": list(found), "types": list(found.values())}

    async def _topics_and_raw_types(self, arguments: Arguments) -> dict[str, Any]:
        told = await self._topics(arguments)
        texts = {
            type_name(structure, function.name): full_text(typedefs(structure, function.name))
            for function, structures in await self._structures()
            for port, structure in structures.items()
            if port.startswith("output.")
        }
        return {**told, "typedefs_full_text": [texts.get(kind, "") for kind in told["types"]]}

    async def _list_services(self, arguments: Arguments) -> dict[str, Any]:
        del arguments
        return {"services": list(await self._all_services())}

    async def _nodes(self, arguments: Arguments) -> dict[str, Any]:
        del arguments
        return {"nodes": [f"/{one.name}" for f in self._functions() for one in f.components]}

    async def _topic_type(self, arguments: Arguments) -> dict[str, Any]:
        found = {**await self._streams(), **self._visible(self._hub.topics)}
        return {"type": found.get(_text(arguments, "topic"), "")}

    async def _topics_for_type(self, arguments: Arguments) -> dict[str, Any]:
        found = {**await self._streams(), **self._visible(self._hub.topics)}
        kind = _text(arguments, "type")
        return {"topics": [name for name, one in found.items() if one == kind]}

    async def _service_type(self, arguments: Arguments) -> dict[str, Any]:
        services = await self._all_services()
        return {"type": services.get(_text(arguments, "service"), "")}

    async def _services_for_type(self, arguments: Arguments) -> dict[str, Any]:
        kind, services = _text(arguments, "type"), await self._all_services()
        return {"services": [name for name, one in services.items() if one == kind]}

    async def _service_node(self, arguments: Arguments) -> dict[str, Any]:
        place = find_place(_text(arguments, "service"))
        nodes = [f"/{one.name}" for one in self._components(place.function)]
        return {"node": nodes[0] if nodes else ""}

    async def _service_providers(self, arguments: Arguments) -> dict[str, Any]:
        kind, services = _text(arguments, "service"), await self._all_services()
        names = (
            [kind] if kind in services else [name for name in services if services[name] == kind]
        )
        found = [one for name in names for one in self._components(find_place(name).function)]
        return {"providers": [f"/{one.name}" for one in found]}

    async def _publishers(self, arguments: Arguments) -> dict[str, Any]:
        place = find_place(_text(arguments, "topic"))
        found = self._components(place.function)
        return {"publishers": [f"/{one.name}" for one in found if one.outputs]}

    async def _subscribers(self, arguments: Arguments) -> dict[str, Any]:
        place = find_place(_text(arguments, "topic"))
        found = self._components(place.function)
        fed = [one for one in found if any(port.source is None for port in one.inputs)]
        return {"subscribers": [f"/{one.name}" for one in fed]}

    async def _node_details(self, arguments: Arguments) -> dict[str, Any]:
        name = _text(arguments, "node").removeprefix("/")
        for function in self._functions():
            for one in function.components:
                if one.name == name:
                    topic = topic_of(function.name)
                    fed = any(port.source is None for port in one.inputs)
                    return {
                        "subscribing": [topic] if fed else [],
                        "publishing": [topic] if one.outputs else [],
                        "services": [topic] if one.service is not None else [],
                    }
        raise UnknownError(f"there is no node {name!r:.100}")

    async def _message_details(self, arguments: Arguments) -> dict[str, Any]:
        kind = _text(arguments, "type")
        for function, structures in await self._structures():
            for port, structure in structures.items():
                if type_name(structure, function.name) == kind and port.startswith("output."):
                    return {"typedefs": typedefs(structure, function.name)}
        raise UnknownError(f"there is no type {kind!r:.100}")

    async def _request_details(self, arguments: Arguments) -> dict[str, Any]:
        return await self._details(_text(arguments, "type"), "request")

    async def _response_details(self, arguments: Arguments) -> dict[str, Any]:
        return await self._details(_text(arguments, "type"), "reply")

    async def _get_time(self, arguments: Arguments) -> dict[str, Any]:
        del arguments
        seconds, nanoseconds = clock_now()
        # ROS 1 clients read secs and nsecs, ROS 2 clients sec and nanosec.
        stamp = {"secs": seconds, "nsecs": nanoseconds, "sec": seconds, "nanosec": nanoseconds}
        return {"time": stamp}

    async def _get_version(self, arguments: Arguments) -> dict[str, Any]:
        """Say that names and messages are those of ROS 2; no distribution stands behind them."""
        del arguments
        return {"version": 2, "distro": f"uoarm {__version__}"}

    async def _get_param(self, arguments: Arguments) -> dict[str, Any]:
        """Answer with JSON; what nobody set has the default that the client names, or null."""
        found = self._parameter(arguments)
        if found is None:
            default = arguments.get("default_value") or arguments.get("default")
            value = default if isinstance(default, str) else _ABSENT
            return {"value": value, **_outcome(done=False)}
        return {"value": found, **_outcome(done=True)}

    async def _set_param(self, arguments: Arguments) -> dict[str, Any]:
        name = self._changeable(arguments)
        self._hub.parameters.set(name, _text(arguments, "value"))
        return _outcome(done=True)

    async def _delete_param(self, arguments: Arguments) -> dict[str, Any]:
        return _outcome(done=self._hub.parameters.delete(self._changeable(arguments)))

    async def _param_names(self, arguments: Arguments) -> dict[str, Any]:
        del arguments
        return {"names": list(self._visible(dict.fromkeys(self._hub.parameters.names, "")))}

    async def _has_param(self, arguments: Arguments) -> dict[str, Any]:
        return {"exists": self._parameter(arguments) is not None}

    def _parameter(self, arguments: Arguments) -> str | None:
        """Return the JSON text of a parameter that is there for this client."""
        name = find_place(_text(arguments, "name")).name
        return self._hub.parameters.get(name) if name in self._visible({name: ""}) else None

    def _changeable(self, arguments: Arguments) -> str:
        place = find_place(_text(arguments, "name"))
        self._client.require(Operation.SEND, place.right)
        return place.name

    async def _action_servers(self, arguments: Arguments) -> dict[str, Any]:
        """Name what takes goals: actions, and services as actions without feedback."""
        del arguments
        taking = [
            topic_of(function.name)
            for function in self._functions()
            if any(is_action(one) or one.service is not None for one in function.components)
        ]
        return {"action_servers": [*taking, *self._visible(self._hub.actions.actions)]}

    async def _details(self, kind: str, part: str) -> dict[str, Any]:
        for function, structures in await self._structures():
            if "request" in structures and kind == type_name(structures["request"], function.name):
                return {"typedefs": typedefs(structures[part], function.name)}
        raise UnknownError(f"there is no service of the type {kind!r:.100}")

    async def _streams(self) -> dict[str, str]:
        """Return the types of all topics of functions; what does not resolve has none."""
        found: dict[str, str] = {}
        for function, structures in await self._structures():
            ports = [port.partition(".")[2] for port in structures if port.startswith("output.")]
            for port in ports:
                name = topic_of(function.name, "" if len(ports) == 1 else port)
                found[name] = type_name(structures[f"output.{port}"], function.name)
            if not ports and any(one.service is None for one in function.components):
                found[topic_of(function.name)] = ""
        return found

    async def _all_services(self) -> dict[str, str]:
        found = {f"{PREFIX}{name}": f"rosapi/{name}" for name in self._services}
        for function, structures in await self._structures():
            if any(one.service is not None for one in function.components):
                structure = structures.get("request")
                kind = "" if structure is None else type_name(structure, function.name)
                found[topic_of(function.name)] = kind
        return found | self._visible(self._hub.services)

    async def _structures(self) -> list[tuple[Function, Mapping[str, MessageStructure]]]:
        functions = {one.name: one for one in self._functions()}
        known = await self._backend.structures(functions)
        return [(one, known[name]) for name, one in functions.items()]

    def _visible(self, named: Mapping[str, str]) -> dict[str, str]:
        return {
            name: kind for name, kind in named.items() if self._role.allows(Operation.SEE, name)
        }

    def _functions(self) -> list[Function]:
        functions = self._backend.robot.config.functions.values()
        return [one for one in functions if self._role.allows(Operation.SEE, one.name)]

    def _components(self, function: str) -> list[Component]:
        return [one for f in self._functions() if f.name == function for one in f.components]


def _outcome(*, done: bool) -> dict[str, Any]:
    """Say how it went, in the fields of rosapi for ROS 2; that of ROS 1 has none."""
    return {"successful": done, "reason": "" if done else "there is no such parameter"}


def _text(arguments: Arguments, name: str) -> str:
    value = arguments.get(name)
    if not isinstance(value, str):
        raise UsageError(f"expected a text as {name!r}")
    return value
