"""What a robot has for viewers: a channel for each output, a service for each service.

Topics are called after functions, `/camera` or `/camera/OUTPUT` where there are several. All that
grows with the robot is made in the thread of the server's views; sessions only pass it on.
"""

from __future__ import annotations

import asyncio
import itertools
import time
import uuid
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

from attrs import frozen

from uoarm.model import Component, Function, MessageStructure, Robot
from uoarm.server.front_end import TEXT_FORM, AccessRole, Backend, without_secrets
from uoarm_foxglove._protocol import StructureCodec, codec_of, write
from uoarm_foxglove._views import view_of

Structures: TypeAlias = Mapping[str, MessageStructure]
_VIEW = "view"
_FRESH_SECONDS = 1.0
_FRAME_OCTETS = 262_144
_PEERS = {"publishedTopics": "publisherIds", "subscribedTopics": "subscriberIds"}
_PARTS = ("channels", "services", "inputs", "graph", "parameters")


def topic_of(function: str, port: str) -> str:
    """Return the name of the topic or service of a function; the port is empty for the only one."""
    return f"/{function}/{port}" if port else f"/{function}"


@frozen(eq=False)
class OutputChannel:
    """An output of a function.

    Attributes:
        number: by which viewers name it.
        port: empty for the only one.
        codec: how its messages are encoded.
        is_view: whether it has what viewers draw, not the messages as they are.
    """

    number: int
    function: str
    port: str
    codec: StructureCodec
    is_view: bool = False

    @property
    def wanted(self) -> str:
        """The function, or function.output, as the manager names it."""
        return f"{self.function}.{self.port}" if self.port else self.function

    @property
    def topic(self) -> str:
        """Under which viewers find it."""
        topic = topic_of(self.function, self.port)
        return f"{topic}/{_VIEW}" if self.is_view else topic

    @property
    def stated(self) -> dict[str, object]:
        """How it is announced."""
        return {"id": self.number, "topic": self.topic, **self.codec.stated}


@frozen(eq=False)
class RobotService:
    """A service of a function; its numbers are other ones than those of channels."""

    number: int
    function: str
    request: StructureCodec
    reply: StructureCodec

    @property
    def stated(self) -> dict[str, object]:
        """How it is announced: with the schemas as viewers of either generation read them."""
        return {
            "id": self.number,
            "name": topic_of(self.function, ""),
            "type": self.request.schema_name.removesuffix("_Request"),
            "request": self.request.stated,
            "response": self.reply.stated,
            "requestSchema": self.request.schema,
            "responseSchema": self.reply.schema,
        }


@frozen
class InputTopic:
    """An input of a function, to which viewers may publish; the port is empty for the only one."""

    function: str
    port: str


@frozen(eq=False)
class VisibleListing:
    """What one role sees.

    Attributes:
        channels: by number.
        services: by number.
        inputs: by topic.
        graph: who publishes, subscribes and serves what, as the protocol has it.
        parameters: of components, as the configuration in force has them, by name: what states it,
            as it is sent, by which 1 and true are two values.
    """

    channels: Mapping[int, OutputChannel]
    services: Mapping[int, RobotService]
    inputs: Mapping[str, InputTopic]
    graph: Mapping[str, list[dict[str, object]]]
    parameters: Mapping[str, bytes]

    def frames_after(self, former: VisibleListing) -> tuple[bytes, ...]:
        """Return what a viewer is sent that knows a former one."""
        gone = [number for number in former.channels if number not in self.channels]
        ended = [number for number in former.services if number not in self.services]
        frames = [write("unadvertise", channelIds=gone)] if gone else []
        frames += [write("unadvertiseServices", serviceIds=ended)] if ended else []
        fresh = list(_batches(_announcements(self.channels, former.channels)))
        if former is NOTHING and not fresh:
            fresh = [[]]  # viewers wait for a first list, and show no service before
        frames += [write("advertise", channels=batch) for batch in fresh]
        begun = _announcements(self.services, former.services)
        frames += [write("advertiseServices", services=batch) for batch in _batches(begun)]
        return tuple(frames)

    def graph_after(self, former: VisibleListing) -> bytes | None:
        """Return how the graph differs from that of a former listing; None: it does not."""
        if self.graph == former.graph:
            return None
        before = {part: _by_name(items) for part, items in former.graph.items()}
        now = {part: _by_name(items) for part, items in self.graph.items()}
        changed: dict[str, list[Any]] = {
            part: [item for name, item in items.items() if before.get(part, {}).get(name) != item]
            for part, items in now.items()
        }
        known = {**before.get("publishedTopics", {}), **before.get("subscribedTopics", {})}
        topics = now["publishedTopics"].keys() | now["subscribedTopics"].keys()
        changed["removedTopics"] = sorted(known.keys() - topics)
        # Of a topic that stays a viewer keeps what was stated last: that it has none any more, too.
        for part, whose in _PEERS.items():
            ended = (before.get(part, {}).keys() - now[part].keys()) & topics
            changed[part] += [{"name": name, whose: []} for name in sorted(ended)]
        served = before.get("advertisedServices", {})
        changed["removedServices"] = sorted(served.keys() - now["advertisedServices"].keys())
        return write("connectionGraphUpdate", **changed)

    def parameters_after(self, former: VisibleListing, names: Collection[str]) -> bytes | None:
        """Return those of some names that are others than in a former listing; None: none are."""
        changed = {
            name for name in names if self.parameters.get(name) != former.parameters.get(name)
        }
        return self.parameter_values(sorted(changed)) if changed else None

    def parameter_values(self, names: Collection[str] = (), **more: object) -> bytes:
        """Return the values of parameters; without names, of all. One that is gone has none."""
        known = self.parameters
        stated = [
            known[name] if name in known else TEXT_FORM.write({"name": name})
            for name in names or known
        ]
        head = write("parameterValues", **more)
        return b'%s,"parameters":[%s]}' % (head[:-1], b",".join(stated))


NOTHING = VisibleListing({}, {}, {}, {}, {})
"""What a viewer knows at first."""


@frozen
class ListingQuestion:
    """What a session asks: what its role sees now, and what is new beside what its viewer knows.

    Attributes:
        known: the listing whose channels and services the viewer has.
        graph: the listing whose graph it has; None: it wants none.
        names: of the parameters whose changes it wants.
    """

    role: AccessRole
    known: VisibleListing = NOTHING
    graph: VisibleListing | None = None
    names: frozenset[str] = frozenset()


@frozen
class ListingAnswer:
    """A listing, and the frames that bring a viewer there."""

    listing: VisibleListing
    frames: tuple[bytes, ...] = ()


@frozen
class _FunctionListing:
    """What one function has; made anew only when it or its structures are others."""

    function: Function
    structures: Structures
    channels: tuple[OutputChannel, ...]
    services: tuple[RobotService, ...]
    inputs: tuple[InputTopic, ...]


class ChannelCatalogue:
    """What all viewers of one server are shown.

    Attributes:
        identity: that no other server has: the numbers of channels are of this one.
    """

    def __init__(self, backend: Backend) -> None:
        self.identity = uuid.uuid4().hex
        self._backend = backend
        self._looked_at = float("-inf")
        self._looking: asyncio.Task[None] | None = None
        # Replaced in the loop, read in the views' thread: one value, so that the two fit.
        self._found: tuple[Robot | None, Mapping[str, Structures]] = None, {}
        # Of the views' thread alone.
        self._numbers = itertools.count(1)
        self._functions: dict[str, _FunctionListing] = {}
        self._listings: dict[AccessRole, VisibleListing] = {}
        self._former: dict[AccessRole, VisibleListing] = {}
        self._made_of: object = None

    async def answer(self, question: ListingQuestion) -> ListingAnswer:
        """Return what a role sees, not older than a second.

        Raises:
            BusyError: the server is closing.
        """
        if time.monotonic() - self._looked_at > _FRESH_SECONDS:
            if self._looking is None:
                self._looking = asyncio.ensure_future(self._look())
                self._looking.add_done_callback(_taken)
            await asyncio.shield(self._looking)
        return await self._backend.view(self.make, question)

    def make(self, questions: Collection[ListingQuestion]) -> dict[ListingQuestion, ListingAnswer]:
        """Return the answers to all that was asked, in the thread of the views."""
        found = self._found
        if found is not self._made_of:
            self._made_of = found
            robot, structures = found
            assert robot is not None, "the robot was looked at before anything was asked"
            self._functions = {
                name: self._listed(function, structures.get(name, {}))
                for name, function in robot.functions.items()
            }
            # Of a role that asks no more, as of an access file that was changed, nothing is kept.
            self._former, self._listings = self._listings, {}
        return {question: self._answer(question) for question in questions}

    def _answer(self, question: ListingQuestion) -> ListingAnswer:
        listing = self._listings.get(question.role)
        if listing is None:
            listing = self._listing(question.role, self._former.get(question.role))
            self._listings[question.role] = listing
        frames: tuple[bytes, ...] = ()
        if listing is not question.known:
            frames = listing.frames_after(question.known)
            values = listing.parameters_after(question.known, question.names)
            frames = frames if values is None else (*frames, values)
        if question.graph is not None and listing is not question.graph:
            graph = listing.graph_after(question.graph)
            frames = frames if graph is None else (*frames, graph)
        return ListingAnswer(listing, frames)

    async def _look(self) -> None:
        try:
            robot = self._backend.robot.config
            self._found = robot, await self._backend.structures(robot.functions)
            self._looked_at = time.monotonic()
        finally:
            self._looking = None

    def _listed(self, function: Function, structures: Structures) -> _FunctionListing:
        known = self._functions.get(function.name)
        if known and known.function is function and known.structures == structures:
            return known
        former = {_announced(item): item for item in known.channels} if known else {}
        outputs, inputs = _outputs(function.components), _inputs(function.components)
        channels = []
        for output in outputs:
            structure = structures.get(f"output.{output}")
            if structure is None:
                continue  # what nothing provides now is announced once something does
            port = output if len(outputs) > 1 else ""
            codec = codec_of(structure, _type_name(function.name, output))
            made = [OutputChannel(next(self._numbers), function.name, port, codec)]
            view = view_of(structure, function.name)
            if view is not None and not (port == "" and _VIEW in outputs):
                number = next(self._numbers)
                made.append(OutputChannel(number, function.name, port, view, is_view=True))
            channels += [former.get(_announced(item), item) for item in made]
        return _FunctionListing(
            function,
            structures,
            tuple(channels),
            tuple(self._services(function.name, structures, known)),
            tuple(InputTopic(function.name, name if len(inputs) > 1 else "") for name in inputs),
        )

    def _services(
        self, function: str, structures: Structures, known: _FunctionListing | None
    ) -> Iterator[RobotService]:
        request, reply = structures.get("request"), structures.get("reply")
        if request is None or reply is None:
            return
        asked = codec_of(request, _type_name(function, "request"))
        answered = codec_of(reply, _type_name(function, "reply"))
        for service in known.services if known else ():
            if (service.request.stated, service.reply.stated) == (asked.stated, answered.stated):
                yield service
                return
        yield RobotService(next(self._numbers), function, asked, answered)

    def _listing(self, role: AccessRole, former: VisibleListing | None) -> VisibleListing:
        view = self._backend.role_views.of(role)
        seen = [item for name, item in self._functions.items() if view.has_function(name)]
        channels = {channel.number: channel for item in seen for channel in item.channels}
        services = {service.number: service for item in seen for service in item.services}
        inputs = {topic_of(i.function, i.port): i for item in seen for i in item.inputs}
        graph = _graph([item.function for item in seen], channels.values())
        components = (component for item in seen for component in item.function.components)
        parameters = {
            name: _stated_parameter(name, value)
            for component in components
            for name, value in _flat(without_secrets(component.parameters), f"/{component.name}/")
        }
        made = VisibleListing(channels, services, inputs, graph, parameters)
        if former is not None and all(
            getattr(former, part) == getattr(made, part) for part in _PARTS
        ):
            return former
        return made


def _announced(channel: OutputChannel) -> tuple[str, ...]:
    """Return all that a viewer knows of a channel beside its number."""
    return channel.topic, *channel.codec.stated.values()


def _stated_parameter(name: str, value: Any) -> bytes:
    """Return a parameter as the protocol states it: floats have a type."""
    stated = {"name": name, "value": value}
    if isinstance(value, float):
        stated["type"] = "float64"
    elif isinstance(value, list) and value and all(isinstance(item, float) for item in value):
        stated["type"] = "float64_array"
    # Not by `write`, which has no integer beyond 64 bits: a configuration may have one.
    return TEXT_FORM.write(stated)


def _flat(parameters: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield parameters by name, those within others as ROS 2 names them: `lens.gain`."""
    for name, value in parameters.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        elif value is not None:
            yield f"{prefix}{name}", value


def _announcements(
    those: Mapping[int, OutputChannel] | Mapping[int, RobotService], known: Collection[int]
) -> list[dict[str, object]]:
    return [item.stated for number, item in those.items() if number not in known]


def _by_name(items: Iterable[dict[str, object]]) -> dict[str, dict[str, object]]:
    return {str(item["name"]): item for item in items}


def _taken(looking: asyncio.Task[None]) -> None:
    """Take what a look raised: those who wait for it raise it, if they have not gone."""
    if not looking.cancelled():
        looking.exception()


def _graph(
    functions: Sequence[Function], channels: Iterable[OutputChannel]
) -> dict[str, list[dict[str, object]]]:
    # Of functions that the role does not see there are no topics here.
    topics: dict[str, list[str]] = {}
    for channel in channels:
        topics.setdefault(channel.function, []).append(channel.topic)
    subscribers: dict[str, list[str]] = {}
    for function in functions:
        for component in function.components:
            for source in dict.fromkeys(_sources(component)):
                for topic in topics.get(source, ()):
                    subscribers.setdefault(topic, []).append(component.name)
    return {
        "publishedTopics": [
            {"name": topic, "publisherIds": [component.name for component in function.components]}
            for function in functions
            for topic in topics.get(function.name, ())
        ],
        "subscribedTopics": [
            {"name": topic, "subscriberIds": names} for topic, names in subscribers.items()
        ],
        "advertisedServices": [
            {"name": topic_of(function.name, ""), "providerIds": providers}
            for function in functions
            if (providers := [c.name for c in function.components if c.service is not None])
        ],
    }


def _sources(component: Component) -> Iterator[str]:
    return (port.source.function for port in component.inputs if port.source is not None)


def _outputs(components: Iterable[Component]) -> list[str]:
    return list(dict.fromkeys(port.name for component in components for port in component.outputs))


def _inputs(components: Iterable[Component]) -> list[str]:
    return list(
        dict.fromkeys(
            port.name
            for component in components
            for port in component.inputs
            if port.source is None
        )
    )


def _type_name(function: str, part: str) -> str:
    """Return a name of ROS's kind for what has none: parts of words, the first of each upper."""
    words = "".join(
        letter if letter.isascii() and letter.isalnum() else " "
        for letter in f"{function} {'' if part == 'default' else part}"
    ).split()
    name = "".join(word[:1].upper() + word[1:] for word in words)
    return f"uoarm/msg/{name if name[:1].isalpha() else f'T{name}'}"


def _batches(stated: Iterable[dict[str, object]]) -> Iterator[list[dict[str, object]]]:
    """Return announcements in lists, of which each makes a frame that is not too long."""
    batch: list[dict[str, object]] = []
    octets = 0
    for item in stated:
        size = sum(len(str(value)) for value in item.values())
        if batch and octets + size > _FRAME_OCTETS:
            yield batch
            batch, octets = [], 0
        batch.append(item)
        octets += size
    if batch:
        yield batch
