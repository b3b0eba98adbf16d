"""What a bridge author supplies: a bridge, components to play with, and ways to harm them.

Values are as the contract has them in memory: octets as bytes, integers as int.
"""

from __future__ import annotations

import copy
import functools
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

import pytest
from attrs import field, frozen

from uoarm._raised import text_of
from uoarm.bridge import Bridge, Registry, Sink, Source
from uoarm.errors import MessageError
from uoarm.model import BridgeSpec, Endpoint, Message, MessageStructure, Schema
from uoarm.schema import check, follow
from uoarm.testing._resources import hold_idle
from uoarm.testing._waiting import Background, Collector, patience, plain, same, slowness

_BUFFERS = (bytes, bytearray, memoryview)
_LONG = 300
_SHOWN = 2000
_AGAIN_SECONDS = 1.0
_SAMPLES: Mapping[str, Any] = {"boolean": True, "integer": 1, "number": 1.0, "string": "item"}
_RESTRICTIONS = frozenset(
    {"const", "contains", "enum", "format", "maxItems", "maxLength", "pattern", "uniqueItems"}
    | {"allOf", "anyOf", "dependentSchemas", "if", "multipleOf", "not", "oneOf", "prefixItems"}
    | {"exclusiveMaximum", "exclusiveMinimum", "minimum", "maximum", "unevaluatedItems"}
    | {"x-max-utf8", "x-max-utf16"}
)
_TYPES: Mapping[str, type] = {"integer": int, "boolean": bool, "string": str}


def with_octets(schema: Schema, message: Any) -> Any:
    """Return the message with lists of octets replaced by bytes, where the schema is plain.

    Follows `$ref`s to definitions, properties and items; leaves unions as they are.
    """
    return _convert(schema, schema, message, strictly=False)


def with_integers(schema: Schema, message: Any) -> Any:
    """Return the message as `with_octets` does, and 7.0 as 7 where an integer is wanted."""
    return _convert(schema, schema, message, strictly=True)


def with_length(schema: Schema, message: Any, octets: int = _LONG) -> Any:
    """Return the message with long texts and lists of scalars, where the schema is plain.

    Args:
        schema: of the message.
        message: fits it.
        octets: length of texts and of octets; other lists have 300 items.
    """
    return _changed(schema, schema, message, partial(_lengthened, octets))


def with_half(schema: Schema, message: Any) -> Any:
    """Return the message with half of a surrogate pair in its texts, where the schema is plain."""
    return _changed(schema, schema, message, _halved)


def find_other_type(schema: Schema, came: Any) -> str:
    """Say where a message has another type in memory than the contract says, "" where nowhere."""
    return next(_other_types(schema, schema, came, "the message"), "")


def _convert(root: Schema, schema: object, value: Any, *, strictly: bool) -> Any:
    schema = _resolved(root, schema)
    if not isinstance(schema, Mapping):
        return value
    if strictly and isinstance(value, float) and schema.get("type") == "integer":
        return int(value)
    if isinstance(value, list):
        if schema.get("x-octets"):
            return bytes(map(int, value))  # 7.0 is an integer in JSON Schema
        return [
            _convert(root, _item(schema, index), item, strictly=strictly)
            for index, item in enumerate(value)
        ]
    if isinstance(value, dict):
        properties = schema.get("properties", {})
        return {
            name: _convert(root, properties.get(name), item, strictly=strictly)
            for name, item in value.items()
        }
    return value


def _changed(
    root: Schema, schema: object, value: Any, change: Callable[[Mapping[str, Any], Any], Any]
) -> Any:
    schema = _resolved(root, schema)
    if not isinstance(schema, Mapping) or _RESTRICTIONS & schema.keys():
        return value
    if isinstance(value, dict):
        properties = schema.get("properties", {})
        return {
            name: _changed(root, properties.get(name), item, change) for name, item in value.items()
        }
    return change(schema, value)


def _lengthened(octets: int, schema: Mapping[str, Any], value: Any) -> Any:
    if isinstance(value, str):
        return ("long " * octets)[:octets]
    if not isinstance(value, list):
        return value
    wanted: Any = schema.get("items")
    plain_item = isinstance(wanted, Mapping) and _one_type(wanted) in _SAMPLES
    if not plain_item or wanted.keys() & _RESTRICTIONS - {"minimum", "maximum"}:
        return value
    sample = _SAMPLES[wanted["type"]]
    fits = wanted.get("minimum", 0) <= 1 <= wanted.get("maximum", 1)
    return [sample] * (octets if schema.get("x-octets") else _LONG) if fits else value


def _shown(message: Message) -> str:
    text = repr(message)
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN // 2]} ... {text[-_SHOWN // 2 :]}"


def _halved(_: Mapping[str, Any], value: Any) -> Any:
    return "half \ud800" if isinstance(value, str) else value


def _other_types(root: Schema, schema: object, value: Any, at: str) -> Iterator[str]:
    schema = _resolved(root, schema)
    if not isinstance(schema, Mapping):
        return
    wanted = _one_type(schema)
    if wanted in _TYPES and type(value) is not _TYPES[wanted]:
        yield f"{at} is {value!r}, a {type(value).__name__} where the structure says {wanted}"
    elif schema.get("x-octets"):
        if not isinstance(value, _BUFFERS):
            yield f"{at}: octets came as {type(value).__name__}, expected bytes"
    elif wanted == "array":
        for index, item in enumerate(plain(value)):
            yield from _other_types(root, _item(schema, index), item, f"{at}[{index}]")
    elif isinstance(value, Mapping):
        for name, property_ in schema.get("properties", {}).items():
            if name in value:
                yield from _other_types(root, property_, value[name], f"{at}.{name}")


def _one_type(schema: Mapping[str, Any]) -> str:
    """Return the type that a schema asks for, "" where it allows several or any."""
    wanted = schema.get("type")
    return wanted if isinstance(wanted, str) else ""


def _item(schema: Mapping[str, Any], index: int) -> object:
    first = schema.get("prefixItems", ())
    return first[index] if index < len(first) else schema.get("items")


def _resolved(root: Schema, schema: object) -> object:
    while isinstance(schema, Mapping) and "$ref" in schema:
        schema = follow(root, schema["$ref"])
    return schema


_TRICKLE_SECONDS = 0.2
_OF_PATHS = "runs_with_one_kind_for_each_path"
PAGE = "docs/bridge-contract.md"
T = TypeVar("T")


@frozen
class Pair:
    """Two endpoints: what is sent to `sink` comes out of `source`, once and in order."""

    sink: Endpoint
    source: Endpoint


@frozen
class Victim:
    """A component with an output that ends when `kill` is called, as when its process dies."""

    source: Endpoint
    kill: Callable[[], object]


@frozen
class LinkVictim:
    """Two endpoints that can be linked, one of which ends when `kill` is called.

    Attributes:
        pair: of two components; `source` feeds `sink`.
        endpoint: the one whose component ends.
        kill: ends it, as when its process dies.
    """

    pair: Pair
    endpoint: Endpoint
    kill: Callable[[], object]


@frozen
class Retained:
    """An output whose last message stands: `emit` has the component emit one and returns it."""

    source: Endpoint
    emit: Callable[[], Message]


@frozen
class Served:
    """A service in the framework.

    Attributes:
        endpoint: where it is.
        request: a request that it answers.
        reply: its answer.
        failing: a service that fails on every request; None where there is no such thing.
        silent: a service that answers no request in time; None where there is no such thing.
        more: further requests to the first service, each with a reply of its own.
        text: a service whose request has text, and such a request; None: `request` has some, or
            there is no such service.
    """

    endpoint: Endpoint
    request: Message
    reply: Message
    failing: Endpoint | None = None
    silent: Endpoint | None = None
    more: Sequence[tuple[Message, Message]] = ()
    text: tuple[Endpoint, Message] | None = None


class World(ABC):
    """The framework as the suite sees it, made anew for each test.

    Must implement: `pair`, `missing`, and `spec` or `bridge`. What else is not overridden is not
    tested, and the test says that it was skipped and why.
    """

    runs_code: bool = False
    """Whether services are functions of the bridge's own process: none ends a call to one, and what
    it raises for a request that does not fit is its own."""

    @property
    def patience(self) -> float:
        """Seconds that a message, or the news of a death, may take at most."""
        return patience()

    def spec(self) -> BridgeSpec | None:
        """Return the bridge as a configuration has it: name, plugin, options.

        It is what runs in a host where the class of tests says `hosted = True`.
        """
        return None

    def registry(self) -> Registry:
        """Return where the plugin of `spec` is found; those installed, unless overridden."""
        return Registry()

    def bridge(self) -> Bridge:
        """Return a new bridge to this world; the test closes it. May be called several times.

        The one of `spec`, unless overridden.
        """
        spec = self.spec()
        assert spec is not None, f"{type(self).__name__} implements neither `bridge` nor `spec`"
        return self.registry().create(spec)

    @abstractmethod
    def pair(self, kind: str) -> Pair:
        """Return the pair of one of the test class's `kinds`, the same for every call.

        What lasts longer than a test, such as a node that sends back what comes, needs other names
        for each world: what it still sends when a test ends would reach the next one.
        """

    @abstractmethod
    def missing(self) -> Endpoint:
        """Return a well-formed output endpoint that is not there."""

    def await_receivers(self, kind: str, count: int) -> None:  # noqa: B027 - mostly they are reached
        """Return once what comes out at a pair's source reaches so many receivers.

        None at first, since one that was closed just now would count for one that is opened.
        Override where a part of this world, such as a node in another process, sends it on and
        learns of a receiver in its own time, which is not reported to the bridge.
        """

    def carried(self, kind: str, message: Message) -> Message:
        """Return what should come out for a message; override where the framework rounds."""
        del kind
        return message

    def takes(self, kind: str, message: Message) -> bool:
        """Whether a message that the structure allows can be sent.

        Override where the framework has a limit that JSON Schema cannot say, such as one on the
        octets of a text; the suite holds that such a message is refused with a MessageError.
        """
        del kind, message
        return True

    def samples(self, kind: str) -> Sequence[Message]:
        """Return messages to be tried beside the generated ones: NaN, very large, recorded."""
        del kind
        return ()

    def victim(self) -> Victim | None:
        """Return a component that can be killed; None where nothing ever dies alone.

        The first of `victims`, unless overridden.
        """
        return next(iter(self.victims()), None)

    def victims(self) -> Sequence[Victim]:
        """Return several components that can be killed, each alone; none where there are not."""
        return ()

    def broken(self) -> bool:
        """Break what the bridge stands on, as a cable or a broker does; False where nothing can.

        Called while a line of a pair is open, at most once before `mended`.
        """
        return False

    def mended(self) -> None:  # noqa: B027 - nothing to mend
        """Mend what `broken` broke."""

    def unreadable(self, kind: str) -> Callable[[], object] | None:
        """Return what emits a payload that cannot be read at a pair's source; None: there is none.

        The first of the kinds is asked for it.
        """
        del kind
        return None

    def retained(self) -> Retained | None:
        """Return an output whose last message stands; None where the framework has none."""
        return None

    def served(self) -> Served | None:
        """Return a service; None for a bridge that cannot call."""
        return None

    def servable(self) -> tuple[Endpoint, Endpoint] | None:
        """Return where a function can be served, and where a client then calls it."""
        return None

    def linkable(self) -> Pair | None:
        """Return two endpoints that the bridge can link; `source` feeds `sink`."""
        return None

    def link_victims(self) -> Sequence[LinkVictim]:
        """Return links of which one end can be killed: each way to link, and each of its ends."""
        return ()


@frozen
class Line:
    """Messages go in at `sink` and arrive at `collector`."""

    world: World
    kind: str
    structure: MessageStructure
    sink: Sink
    source: Source
    collector: Collector
    # Of what did not come: a line that loses does so again, as Hypothesis looks for less that shows
    # it, and each of these looks would last as long as the first.
    _lost: list[Message] = field(factory=list, init=False)

    def send(self, message: Message) -> None:
        """Send one message, its octets as bytes."""
        given = with_octets(self.structure.schema, message)
        before = copy.deepcopy(given)
        self.sink.send(given)
        assert same(given, before), f"sending changed the message from {before!r} to {given!r}"

    def example(self) -> Message:
        """Return a simple message of the structure."""
        return example_of(self.structure)

    def carries_or_refuses(self, message: Message) -> None:
        """Hold that a message comes out, or is refused in words where it cannot be sent."""
        if self.world.takes(self.kind, message):
            self.carries(message)
            return
        with pytest.raises(MessageError):
            self.send(message)

    def carries(self, *messages: Message) -> list[Message]:
        """Send messages, hold that they come out, each once and in order, and return them."""
        before = len(self.collector.messages)
        for message in messages:
            self.send(message)
        limit = self.world.patience
        if self._lost:
            limit = min(limit, _AGAIN_SECONDS * slowness())
        try:
            came = self.collector.wait(before + len(messages), limit)[before:]
        except AssertionError as error:
            self._lost.extend(messages)
            came = self.collector.messages[before:]
            text = f"{error}: sent {_shown(list(messages))}, came {_shown(came)}"
            raise AssertionError(text) from None
        wanted = [self.world.carried(self.kind, message) for message in messages]
        for sent, got in zip(wanted, came, strict=False):
            assert same(got, sent), f"sent {_shown(sent)}, came {_shown(got)}"
        assert len(came) == len(wanted), f"{len(wanted)} were sent, {len(came)} came"
        return came


@contextmanager
def line(world: World, bridge: Bridge, kind: str) -> Iterator[Line]:
    """Open both ends, the receiving one first, and close them at the end."""
    pair = world.pair(kind)
    collector = Collector()
    structure = structure_of(bridge, pair, incoming=False)
    source = bridge.open_source(pair.source, structure, collector.deliver)
    try:
        sink = bridge.open_sink(pair.sink, structure_of(bridge, pair, incoming=True))
        try:
            yield Line(world, kind, structure, sink, source, collector)
        finally:
            sink.close()
    finally:
        source.close()


def hold_bridge_idle(world: World, bridge: Bridge, moment: str) -> None:
    """Hold that the bridge takes hardly any processor time, in this process and in its host."""
    others = () if bridge.process_id is None else (bridge.process_id,)
    hold_idle(moment, *others, timeout=world.patience)


def hold_idle_between(through: Line, bridge: Bridge) -> None:
    """Hold the same while a message passes every now and then."""
    stop = threading.Event()

    def send() -> None:
        message = through.example()
        while not stop.wait(_TRICKLE_SECONDS):
            through.send(message)

    trickling = Background(send)
    try:
        hold_bridge_idle(through.world, bridge, "between messages")
    finally:
        stop.set()
    trickling.result(through.world.patience)


def supplied(found: T | None, why_not: str) -> T:
    """Return what a world supplies; where it does not, skip the test with the reason."""
    if found is None:
        pytest.skip(why_not)
    return found


def structure_of(bridge: Bridge, pair: Pair, *, incoming: bool) -> MessageStructure:
    """Return what the bridge says of one end of a pair.

    Raises:
        AssertionError: it describes no message there.
    """
    endpoint = pair.sink if incoming else pair.source
    description = bridge.describe(endpoint)
    assert description.message is not None, f"{endpoint} is described without a message"
    return description.message


def example_of(structure: MessageStructure) -> Message:
    """Return a simple message of a structure: the one that shows that some message fits it.

    Raises:
        AssertionError: none does, or none is found.
    """
    verdict = check(structure.schema, False)
    assert verdict.compatible is False, f"no message fits {structure.schema}: {verdict}"
    return verdict.build_counterexample()


def examples_of_service(bridge: Bridge, called: Endpoint) -> tuple[Message, Message]:
    """Return a request and a reply of a service that is served."""
    description = bridge.describe(called)
    assert description.request is not None
    assert description.reply is not None
    return example_of(description.request), example_of(description.reply)


def rules(section: str) -> Callable[[type[T]], type[T]]:
    """Have the failures of a class of tests name the endpoint, the rule and its section.

    A test's name is its rule.

    Args:
        section: anchor on the page on the contract of bridges.
    """

    def mark(tests: type[T]) -> type[T]:
        for name, test in list(vars(tests).items()):
            if name.startswith("test_"):
                setattr(tests, name, _naming(test, section))
        return tests

    return mark


def of_paths(test: Callable[..., None]) -> Callable[..., None]:
    """Have a test run once for each of the suite's `paths`, not for each of its kinds.

    For what holds of a link whatever it carries: kinds of one path differ in the structure of
    their messages alone, of which such a test has one carried at most, while all is well.
    """
    test.__dict__[_OF_PATHS] = True
    return test


def is_of_paths(test: Callable[..., None]) -> bool:
    """Whether a test was marked with `of_paths`."""
    return _OF_PATHS in vars(test)


def rule_of(test: Callable[..., None]) -> str:
    """Return the rule that a test holds, as a sentence."""
    return test.__name__.removeprefix("test_").replace("_", " ")


def _naming(test: Callable[..., None], section: str) -> Callable[..., None]:
    @functools.wraps(test)
    def run(*given: Any, **named: Any) -> None:
        try:
            test(*given, **named)
        except (Exception, SystemExit, GeneratorExit, pytest.fail.Exception) as error:
            text = f"{_place(named)}: the rule is: {rule_of(test)} ({PAGE}#{section})"
            ends = isinstance(error, SystemExit | GeneratorExit)  # whose own text is a number
            said = text_of(error) if ends else error
            raise AssertionError(f"{text}\n{said}") from error

    return run


def _place(named: dict[str, Any]) -> str:
    """Say what a test was about, as far as its arguments say so."""
    if "served" in named:
        return str(named["served"].endpoint)
    if "kind" in named:
        pair = named["world"].pair(named["kind"])
        return f"{pair.sink} to {pair.source}"
    return f"bridge {named['bridge'].name!r}" if "bridge" in named else "the bridge"
