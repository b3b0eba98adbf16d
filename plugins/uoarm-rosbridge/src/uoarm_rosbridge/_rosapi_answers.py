"""What the services of rosapi answer, of one look at the robot and as one role sees it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property, lru_cache
from typing import Any, TypeAlias

import orjson
from attrs import frozen

from uoarm.cdr import BASIC, RosDefinition, structure_of_definition
from uoarm.errors import UoarmError, UsageError
from uoarm.model import Component, Function, Message, MessageStructure
from uoarm.server.front_end import AccessRole, Operation, UnknownError, is_action
from uoarm_rosbridge._hub import Hub
from uoarm_rosbridge._names import topic_of
from uoarm_rosbridge._types import (
    full_text,
    in_full,
    is_same_type,
    part_within,
    service_type,
    type_name,
    typedefs,
)

PREFIX = "/rosapi/"
Arguments: TypeAlias = Mapping[str, Any]
Structures: TypeAlias = Mapping[str, MessageStructure]
OWN = frozenset(
    {"get_time", "get_ros_version", "get_param", "set_param", "delete_param", "has_param"}
)
"""Services that are answered for each client by itself; the others of the whole robot."""
_LONGEST = 1_000
_NODE, _CLIENTS = "/rosapi", "/rosbridge_websocket"
"""The nodes that rosbridge has: what answers here, and what clients publish and serve with."""

_DETAILS = "TypeDef[] typedefs"
_DONE = "bool successful, string reason"
_TYPES: Mapping[str, tuple[str, str, str]] = {
    "topics": ("Topics", "", "string[] topics, string[] types"),
    "topics_for_type": ("TopicsForType", "string type", "string[] topics"),
    "topics_and_raw_types": (
        "TopicsAndRawTypes",
        "",
        "string[] topics, string[] types, string[] typedefs_full_text",
    ),
    "topic_type": ("TopicType", "string topic", "string type"),
    "publishers": ("Publishers", "string topic", "string[] publishers"),
    "subscribers": ("Subscribers", "string topic", "string[] subscribers"),
    "services": ("Services", "", "string[] services"),
    "services_for_type": ("ServicesForType", "string type", "string[] services"),
    "service_type": ("ServiceType", "string service", "string type"),
    "service_node": ("ServiceNode", "string service", "string node"),
    "service_providers": ("ServiceProviders", "string service", "string[] providers"),
    "nodes": ("Nodes", "", "string[] nodes"),
    "node_details": (
        "NodeDetails",
        "string node",
        "string[] subscribing, string[] publishing, string[] services",
    ),
    "interfaces": ("Interfaces", "", "string[] interfaces"),
    "message_details": ("MessageDetails", "string type", _DETAILS),
    "service_request_details": ("ServiceRequestDetails", "string type", _DETAILS),
    "service_response_details": ("ServiceResponseDetails", "string type", _DETAILS),
    "action_servers": ("GetActionServers", "", "string[] action_servers"),
    "action_type": ("ActionType", "string action", "string type"),
    "action_goal_details": ("ActionGoalDetails", "string type", _DETAILS),
    "action_result_details": ("ActionResultDetails", "string type", _DETAILS),
    "action_feedback_details": ("ActionFeedbackDetails", "string type", _DETAILS),
    "get_param": ("GetParam", "string name, string default_value", f"string value, {_DONE}"),
    "set_param": ("SetParam", "string name, string value", _DONE),
    "delete_param": ("DeleteParam", "string name", _DONE),
    "get_param_names": ("GetParamNames", "", "string[] names"),
    "has_param": ("HasParam", "string name", "bool exists"),
    "get_time": ("GetTime", "", "builtin_interfaces/Time time"),
    "get_ros_version": ("GetROSVersion", "", "uint8 version, string distro"),
}
"""Services of rosapi: their types in the package rosapi_msgs, their requests and responses."""

_WITHIN = """
===
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
===
MSG: rosapi_msgs/TypeDef
string type
string[] fieldnames
string[] fieldtypes
int32[] fieldarraylen
string[] examples
string[] constnames
string[] constvalues
"""


@frozen
class Question:
    """A service of rosapi that is asked, as which role and with which arguments.

    Attributes:
        arguments: those that are texts, by name.
    """

    role: AccessRole
    service: str
    arguments: tuple[tuple[str, str], ...] = ()


class ListedFunction:
    """One function with the structures that it has now, and what was computed of these.

    Args:
        structures: by port.
    """

    def __init__(self, function: Function, structures: Structures) -> None:
        self.function = function
        self.structures = structures

    @cached_property
    def topics(self) -> dict[str, str]:
        """Types of its topics; empty where it does not resolve."""
        known = _topics(self.function, self.structures)
        if not known and any(part.service is None for part in self.function.components):
            return {topic_of(self.function.name): ""}
        return known

    @cached_property
    def texts(self) -> dict[str, str]:
        """The definitions of its types, as texts."""
        name = self.function.name
        return {
            type_name(structure, name): full_text(structure, name)
            for structure in self.structures.values()
        }


class RosapiAnswers:
    """The answers for one role. Components appear as nodes. In the thread of the views.

    No answer waits for what is not there: a topic whose type is not known yet has an empty one, and
    has it in a later answer once it can be had.

    Args:
        role: sees what its clients are shown.
        types: native types that were looked up; None: no plugin knows it.

    Attributes:
        unknown: types that an answer needs and that are to be looked up first.
    """

    def __init__(
        self,
        role: AccessRole,
        listed: Iterable[ListedFunction],
        hub: Hub,
        types: Mapping[str, MessageStructure | None],
    ) -> None:
        self._role = role
        self._hub = hub
        self._types = types
        self._listed = [item for item in listed if role.allows(Operation.SEE, item.function.name)]
        self._structures = [(item.function, item.structures) for item in self._listed]
        self._parts = [
            (function, component)
            for function, _ in self._structures
            for component in function.components
        ]
        self.unknown: set[str] = set()

    def answer(self, question: Question) -> bytes | frozenset[str] | UoarmError:
        """Return the written values, the types to look up first, or why there is no answer."""
        self.unknown = set()
        try:
            values = getattr(self, f"_{question.service}")(dict(question.arguments))
        except UoarmError as error:
            return frozenset(self.unknown) or error
        return frozenset(self.unknown) or orjson.dumps(values)

    def _topics(self, arguments: Arguments) -> dict[str, Any]:
        del arguments
        found = self._all_topics
        return {"topics": list(found), "types": list(found.values())}

    def _topics_and_raw_types(self, arguments: Arguments) -> dict[str, Any]:
        found = self._topics(arguments)
        texts = {"": ""}
        for listed in self._listed:
            texts |= listed.texts
        for kind in found["types"]:
            if kind not in texts:
                known = self._of_type(in_full(kind, "msg"))
                unknown = f"# there is no definition of {kind}\n"
                texts[kind] = unknown if known is None else full_text(known, "")
        return {**found, "typedefs_full_text": [texts[kind] for kind in found["types"]]}

    def _topics_for_type(self, arguments: Arguments) -> dict[str, Any]:
        kind, found = text_of(arguments, "type"), self._all_topics
        return {"topics": [name for name, value in found.items() if is_same_type(value, kind)]}

    def _topic_type(self, arguments: Arguments) -> dict[str, Any]:
        topic = _name(arguments, "topic")
        found = self._all_topics
        if topic not in found:  # a single port may be named, too, where it need not be
            for function, structures in self._structures:
                port = topic.removeprefix(f"{topic_of(function.name)}/")
                places = [f"{role}.{port}" for role in ("output", "input")]
                known = next((structures[place] for place in places if place in structures), None)
                if port != topic and known is not None:
                    return {"type": type_name(known, function.name)}
        return {"type": found.get(topic, "")}

    def _publishers(self, arguments: Arguments) -> dict[str, Any]:
        return {"publishers": self._nodes_at(arguments, _given, self._hub.published)}

    def _subscribers(self, arguments: Arguments) -> dict[str, Any]:
        return {"subscribers": self._nodes_at(arguments, _fed, self._hub.subscribed)}

    def _nodes_at(
        self, arguments: Arguments, ports: Callable[[Component], list[str]], of_clients: list[str]
    ) -> list[str]:
        topic = _name(arguments, "topic")
        own = [
            f"/{component.name}"
            for function, component in self._parts
            if _means(topic, function, ports(component))
        ]
        return own + self._by_clients(topic, of_clients)

    def _services(self, arguments: Arguments) -> dict[str, Any]:
        del arguments
        return {"services": list(self._all_services)}

    def _services_for_type(self, arguments: Arguments) -> dict[str, Any]:
        kind, found = text_of(arguments, "type"), self._all_services
        return {"services": [name for name, value in found.items() if is_same_type(value, kind)]}

    def _service_type(self, arguments: Arguments) -> dict[str, Any]:
        return {"type": self._all_services.get(_name(arguments, "service"), "")}

    def _service_node(self, arguments: Arguments) -> dict[str, Any]:
        return {"node": next(iter(self._nodes_of(_name(arguments, "service"))), "")}

    def _service_providers(self, arguments: Arguments) -> dict[str, Any]:
        """Name the nodes with a service of a type; of a service, where that is what is named."""
        kind, services = text_of(arguments, "service"), self._all_services
        name = _name(arguments, "service")
        names = (
            [name] if name in services else [n for n in services if is_same_type(services[n], kind)]
        )
        found = dict.fromkeys(node for text in names for node in self._nodes_of(text))
        return {"providers": list(found)}

    def _nodes(self, arguments: Arguments) -> dict[str, Any]:
        del arguments
        own = [f"/{component.name}" for _, component in self._parts]
        return {"nodes": list(dict.fromkeys((*own, _NODE, _CLIENTS)))}

    def _node_details(self, arguments: Arguments) -> dict[str, Any]:
        node = _name(arguments, "node")
        subscribing, publishing, services = list[str](), list[str](), list[str]()
        parts = [(f, item) for f, item in self._parts if f"/{item.name}" == node]
        for function, component in parts:
            subscribing += _named(function, _fed(component))
            publishing += _named(function, _given(component))
            services += [topic_of(function.name)] if component.service is not None else []
        if node == _CLIENTS:
            subscribing += self._visible(dict.fromkeys(self._hub.subscribed, ""))
            publishing += self._visible(dict.fromkeys(self._hub.published, ""))
            services += self._visible(self._hub.services)
        elif node == _NODE:
            services += [f"{PREFIX}{name}" for name in _TYPES]
        elif not parts:
            raise UnknownError(f"there is no node {node!r:.100}")
        return {"subscribing": subscribing, "publishing": publishing, "services": services}

    def _interfaces(self, arguments: Arguments) -> dict[str, Any]:
        """Name the types that this robot and the clients speak; what is installed is not listed."""
        del arguments
        found = {*self._all_topics.values(), *self._all_services.values()}
        found |= {self._type_of_action(name) for name in self._all_actions()}
        return {"interfaces": sorted(found - {""})}

    def _message_details(self, arguments: Arguments) -> dict[str, Any]:
        kind = text_of(arguments, "type")
        if kind in BASIC:
            return {"typedefs": []}
        known = [
            (f, message_structure)
            for f, several in self._structures
            for message_structure in several.values()
        ]
        for function, structure in known:
            if is_same_type(type_name(structure, function.name), kind):
                return {"typedefs": typedefs(structure, function.name)}
        installed = self._of_type(in_full(kind, "msg"))
        parts = (part_within(structure, kind) for _, structure in known)
        return {"typedefs": _found(installed or next(filter(None, parts), None), "type", kind)}

    def _service_request_details(self, arguments: Arguments) -> dict[str, Any]:
        return self._details(text_of(arguments, "type"), "request")

    def _service_response_details(self, arguments: Arguments) -> dict[str, Any]:
        return self._details(text_of(arguments, "type"), "reply")

    def _action_servers(self, arguments: Arguments) -> dict[str, Any]:
        """Name what takes goals: actions, and services as actions without feedback."""
        del arguments
        return {"action_servers": self._all_actions()}

    def _action_type(self, arguments: Arguments) -> dict[str, Any]:
        return {"type": self._type_of_action(_name(arguments, "action"))}

    def _action_goal_details(self, arguments: Arguments) -> dict[str, Any]:
        return self._part_of_action(text_of(arguments, "type"), "_Goal")

    def _action_result_details(self, arguments: Arguments) -> dict[str, Any]:
        return self._part_of_action(text_of(arguments, "type"), "_Result")

    def _action_feedback_details(self, arguments: Arguments) -> dict[str, Any]:
        return self._part_of_action(text_of(arguments, "type"), "_Feedback")

    def _get_param_names(self, arguments: Arguments) -> dict[str, Any]:
        del arguments
        return {"names": list(self._visible(dict.fromkeys(self._hub.parameters.names, "")))}

    @cached_property
    def _all_topics(self) -> dict[str, str]:
        """Types of all topics; what does not resolve has none."""
        found: dict[str, str] = {}
        for listed in self._listed:
            found |= listed.topics
        return found | self._visible(self._hub.topics)

    @cached_property
    def _all_services(self) -> dict[str, str]:
        found = {f"{PREFIX}{name}": _own_type(name) for name in _TYPES}
        for function, structures in self._structures:
            if any(component.service is not None for component in function.components):
                request = structures.get("request")
                kind = "" if request is None else service_type(request, function.name)
                found[topic_of(function.name)] = kind
        return found | self._visible(self._hub.services)

    def _all_actions(self) -> list[str]:
        taking = dict.fromkeys(
            topic_of(function.name)
            for function, component in self._parts
            if is_action(component) or component.service is not None
        )
        return [*taking, *self._visible(self._hub.actions.actions)]

    def _type_of_action(self, name: str) -> str:
        for function, structures in self._structures:
            goal = structures.get("input.goal", structures.get("request"))
            if topic_of(function.name) == name and goal is not None:
                return service_type(goal, function.name)
        return self._visible(self._hub.actions.actions).get(name, "")

    def _details(self, kind: str, part: str) -> dict[str, Any]:
        own = next((name for name in _TYPES if is_same_type(_own_type(name), kind)), "")
        if own:
            return {"typedefs": typedefs(_own_structures(own)[part == "reply"], "")}
        for function, structures in self._structures:
            request = structures.get("request")
            if request is None:
                continue
            names = type_name(request, function.name), service_type(request, function.name)
            if any(is_same_type(name, kind) for name in names):
                return {"typedefs": typedefs(structures[part], function.name)}
        ending = "_Request" if part == "request" else "_Response"
        structure = self._of_type(in_full(kind, "srv", ending))
        return {"typedefs": _found(structure, "service of the type", kind)}

    def _part_of_action(self, kind: str, ending: str) -> dict[str, Any]:
        structure = self._of_type(in_full(kind, "action", ending))
        return {"typedefs": _found(structure, "action of the type", kind)}

    def _of_type(self, name: str) -> MessageStructure | None:
        if name and name not in self._types:
            self.unknown.add(name)
        return self._types.get(name)

    def _nodes_of(self, service: str) -> list[str]:
        """Return the nodes that answer a service."""
        if service.startswith(PREFIX):
            return [_NODE] if service.removeprefix(PREFIX) in _TYPES else []
        own = [
            f"/{component.name}"
            for function, component in self._parts
            if component.service is not None and topic_of(function.name) == service
        ]
        return own + self._by_clients(service, self._hub.services)

    def _by_clients(self, name: str, of_clients: Any) -> list[str]:
        """Return the node of the clients, where they have a topic or a service that may be seen."""
        return [_CLIENTS] if name in of_clients and self._visible({name: ""}) else []

    def _visible(self, named: Mapping[str, str]) -> dict[str, str]:
        return {
            name: kind for name, kind in named.items() if self._role.allows(Operation.SEE, name)
        }


def _topics(function: Function, structures: Structures) -> dict[str, str]:
    """Return the types of a function's topics: of its outputs, and of inputs that clients feed."""
    fed = {f"input.{port}" for component in function.components for port in _fed(component)}
    outputs = [place for place in structures if place.startswith("output.")]
    inputs = [place for place in structures if place in fed]
    found: dict[str, str] = {}
    for places in (outputs, inputs):
        for place in places:
            name = topic_of(function.name, "" if len(places) == 1 else place.partition(".")[2])
            found.setdefault(name, type_name(structures[place], function.name))
    return found


def _fed(component: Component) -> list[str]:
    return [port.name for port in component.inputs if port.source is None]


def _given(component: Component) -> list[str]:
    return [port.name for port in component.outputs]


def _named(function: Function, ports: list[str]) -> list[str]:
    """Return the topics of ports of one kind."""
    return [topic_of(function.name, "" if len(ports) == 1 else port) for port in ports]


def _means(topic: str, function: Function, ports: list[str]) -> bool:
    """Say whether a topic is one of these ports; the name of the function alone is the first."""
    names = {topic_of(function.name, port) for port in ports}
    return topic in names or (bool(names) and topic == topic_of(function.name))


def _own_type(service: str) -> str:
    return f"rosapi_msgs/srv/{_TYPES[service][0]}"


@lru_cache(maxsize=len(_TYPES))
def _own_structures(service: str) -> tuple[MessageStructure, MessageStructure]:
    """Return what a service of rosapi takes and what it answers."""
    _, request, response = _TYPES[service]
    name = _own_type(service)
    return _structure(f"{name}_Request", request), _structure(f"{name}_Response", response)


def _structure(name: str, fields: str) -> MessageStructure:
    definition = RosDefinition(name, fields.replace(", ", "\n") + _WITHIN)
    return MessageStructure(structure_of_definition(definition).schema, native_type=name)


def arguments_by_name(service: str, arguments: Message) -> Arguments | None:
    """Return the arguments of a service by name; None: there is no such service.

    A list is taken in the order of the fields, too.
    """
    if service not in _TYPES:
        return None
    if isinstance(arguments, list):
        return dict(zip(_fields(service), arguments, strict=False))
    return arguments if isinstance(arguments, dict) else {}


def question(role: AccessRole, service: str, arguments: Arguments) -> Question:
    """Return what is asked, with the arguments that the service takes."""
    texts = ((name, arguments.get(name)) for name in _fields(service))
    shown = tuple((name, text[:_LONGEST]) for name, text in texts if isinstance(text, str))
    return Question(role, service, shown)


def _fields(service: str) -> list[str]:
    return [field.split()[1] for field in _TYPES[service][1].split(", ") if field]


def _found(structure: MessageStructure | None, what: str, kind: str) -> list[dict[str, Any]]:
    if structure is None:
        raise UnknownError(f"there is no {what} {kind!r:.100}")
    return typedefs(structure, "")


def _name(arguments: Arguments, field: str) -> str:
    """Return the name of a topic, a service or a node; a missing leading slash is added."""
    return f"/{text_of(arguments, field).lstrip('/')}"


def text_of(arguments: Arguments, name: str) -> str:
    """Return an argument that is a text; raises UsageError."""
    value = arguments.get(name)
    if not isinstance(value, str):
        raise UsageError(f"expected a text as {name!r}")
    return value
