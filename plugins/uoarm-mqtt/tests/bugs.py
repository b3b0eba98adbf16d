"""Deliberate bugs in this bridge, each with the rule of the conformance kit that catches it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

from attrs import evolve, frozen
from uoarm_mqtt import _bridge, _channels, _client, _codec, _health, _link, _subscriptions

from uoarm.bridge import Disconnection, ReceiveQueue
from uoarm.errors import BridgeError, MessageError
from uoarm.model import Health
from uoarm.testing.conformance._describing import Describing
from uoarm.testing.conformance._ending import EndingRules
from uoarm.testing.conformance._failures import Breaking, DisturbanceRules
from uoarm.testing.conformance._flow import Flow, ServiceRules
from uoarm.testing.conformance._world import rule_of


@frozen
class Bug:
    """One deliberate bug.

    Args:
        name: what the bridge does.
        owner: a class or module of the bridge.
        part: what of it is replaced.
        replace: takes what was there and returns what replaces it.
        caught: the test of the suite that fails.
        says: a part of what it says then.
    """

    name: str
    owner: Any
    part: str
    replace: Callable[[Any], Any]
    caught: Callable[..., None]
    says: str


def nothing(_: Any) -> Any:
    return lambda *_, **__: None


def always(value: object) -> Callable[[Any], Any]:
    return lambda _: lambda *_, **__: value


def swallowing(*kinds: type[Exception]) -> Callable[[Any], Any]:
    def replace(original: Any) -> Any:
        @functools.wraps(original)
        def swallow(*given: Any, **named: Any) -> Any:
            try:
                return original(*given, **named)
            except kinds:
                return None

        return swallow

    return replace


def unsaid(original: Any) -> Any:
    return lambda *given: (original(*given), None)[1]


def on_one_thread(_: Any) -> Any:
    return lambda backlog, message: backlog._take(message)


def as_float(_: Any) -> Any:
    return lambda value: float(value) if isinstance(value, int) else value


def to_the_newest(original: Any) -> Any:
    return lambda table, message: original(table, message)[-1:]


def to_every_receiver(_: Any) -> Any:
    return lambda table, _message: list(table)


def without_retained(original: Any) -> Any:
    def subscribe(link: Any, receiver: Any, qos: int, **named: Any) -> Any:
        receiver.retained = False
        return original(link, receiver, qos, **named)

    return subscribe


def the_first_reply(original: Any) -> Any:
    kept: list[Any] = []

    def take(calls: Any, incoming: Any) -> None:
        kept.append(incoming)
        original(calls, evolve(kept[0], properties=incoming.properties))

    return take


def never_latched(original: Any) -> Any:
    def init(source: Any, *given: Any) -> None:
        original(source, *given)
        source.latched = False

    return init


def of_the_whole(original: Any) -> Any:
    def take(source: Any, incoming: Any) -> None:
        original(source, incoming)
        if source.unreadable:
            source._link.report(Health.LOST, "it cannot be read")

    return take


def of_no_component(original: Any) -> Any:
    def init(components: Any, link: Any, wait: float, report: Any) -> None:
        def of_another(_: str, health: Health, cause: str) -> None:
            report("another", health, cause)

        original(components, link, wait, of_another)

    return init


def reported_twice(original: Any) -> Any:
    def down(link: Any, cause: str, **named: Any) -> None:
        original(link, cause, **named)
        link.report(Health.DEGRADED, cause)

    return down


def as_none(original: Any) -> Any:
    def decode(*given: Any) -> Any:
        try:
            return original(*given)
        except MessageError:
            return None

    return decode


def in_ascii(original: Any) -> Any:
    def encode(codec: Any, message: Any) -> Any:
        return original(codec, message).decode().encode("ascii", "replace")

    return encode


def raw(original: Any) -> Any:
    return lambda codec, message: codec._encode(message)


def without_a_reply(original: Any) -> Any:
    return lambda *given: evolve(original(*given), reply=None)


def keeping_only(_: Any) -> Any:
    def take(watched: Any, incoming: Any) -> None:
        watched.payload = incoming.payload
        watched._came.set()

    return take


def never_failing(original: Any) -> Any:
    def init(
        served: Any, endpoint: Any, options: Any, offers: Any, handler: Any, *more: Any
    ) -> None:
        def handle(request: Any) -> Any:
            try:
                return handler(request)
            except ArithmeticError:
                return {"value": 0}

        original(served, endpoint, options, offers, handle, *more)

    return init


BUGS: tuple[Bug, ...] = (
    Bug(
        "subscribes to nothing again after a break",
        _subscriptions.Subscriptions,
        "__iter__",
        always(iter(())),
        Breaking.test_messages_pass_again_once_it_is_mended_each_once,
        "messages came",
    ),
    Bug(
        "reports the break with each attempt to connect",
        _link.BrokerConnection,
        "_down",
        reported_twice,
        Breaking.test_a_break_is_reported_with_its_cause_and_so_is_its_end,
        "reported again",
    ),
    Bug(
        "does not report that the broker is back",
        Disconnection,
        "up",
        unsaid,
        Breaking.test_a_break_is_reported_with_its_cause_and_so_is_its_end,
        "it was not reported",
    ),
    Bug(
        "says nothing of a broker that is killed",
        _link.BrokerConnection,
        "_down",
        nothing,
        Breaking.test_a_break_is_reported_with_its_cause_and_so_is_its_end,
        "a break was not reported",
    ),
    Bug(
        "says nothing of a broker that is killed while an output is open alone",
        _link.BrokerConnection,
        "_down",
        nothing,
        Breaking.test_a_break_is_reported_of_an_output_that_is_open_alone,
        "it was not reported",
    ),
    Bug(
        "drops what is sent while the broker is away",
        _channels.MqttSink,
        "_send",
        swallowing(BridgeError),
        Breaking.test_what_is_sent_while_it_is_broken_is_refused_or_counted_or_arrives,
        "vanished",
    ),
    Bug(
        "delivers in the thread of the network",
        ReceiveQueue,
        "put",
        on_one_thread,
        DisturbanceRules.test_another_channel_opens_while_a_consumer_is_stuck,
        "still running",
    ),
    Bug(
        "lets paho's exception for a payload out of send",
        _codec.PayloadCodec,
        "encode",
        raw,
        DisturbanceRules.test_a_message_that_fits_nothing_is_refused_in_words_or_carried,
        "has no form in JSON",
    ),
    Bug(
        "drops a payload that cannot be read, in silence",
        _channels.MqttSource,
        "_take",
        lambda original: (
            lambda source, incoming: (
                None if incoming.payload.endswith(b"[") else original(source, incoming)
            )
        ),
        DisturbanceRules.test_what_cannot_be_read_is_said_and_ends_nothing,
        "nothing was said",
    ),
    Bug(
        "delivers None for a payload that cannot be read",
        _codec.PayloadCodec,
        "decode",
        as_none,
        DisturbanceRules.test_what_cannot_be_read_is_said_and_ends_nothing,
        "the payload was delivered",
    ),
    Bug(
        "reports the whole bridge lost for one payload",
        _channels.MqttSource,
        "_take",
        of_the_whole,
        DisturbanceRules.test_what_cannot_be_read_is_said_and_ends_nothing,
        "one payload ended the channel",
    ),
    Bug(
        "takes no notice of a last will",
        _health.RetainedTopic,
        "_take",
        keeping_only,
        DisturbanceRules.test_a_death_is_reported_with_its_cause,
        "a killed component was not reported",
    ),
    Bug(
        "reports deaths of a component of another name",
        _health.Components,
        "__init__",
        of_no_component,
        DisturbanceRules.test_each_death_is_reported_of_its_own_component,
        "it was not reported",
    ),
    Bug(
        "delivers octets in JSON as texts",
        _codec,
        "_octets",
        lambda _: lambda value: value,
        Flow.test_recorded_samples_survive,
        "'image': 'AP8='",
    ),
    Bug(
        "delivers integers in JSON as floats",
        _codec,
        "_integer",
        as_float,
        Flow.test_values_arrive_with_their_types,
        "a float where the structure says integer",
    ),
    Bug(
        "writes JSON in ASCII",
        _codec.PayloadCodec,
        "encode",
        in_ascii,
        Flow.test_recorded_samples_survive,
        "Kia ora ?",
    ),
    Bug(
        "gives what two subscribed to, to one",
        _subscriptions.Subscriptions,
        "route",
        to_the_newest,
        Flow.test_two_receivers_get_the_same,
        "0 of 1 messages came",
    ),
    Bug(
        "gives every message to every channel",
        _subscriptions.Subscriptions,
        "route",
        to_every_receiver,
        Flow.test_kinds_do_not_mix,
        "kinds do not mix",
    ),
    Bug(
        "does not ask for what is retained",
        _link.BrokerConnection,
        "_subscribe",
        without_retained,
        Flow.test_a_retained_message_comes_first,
        "0 of 1 messages came",
    ),
    Bug(
        "does not say that the last message is retained",
        _channels.MqttSource,
        "__init__",
        never_latched,
        Flow.test_a_retained_message_comes_first,
        "what retains messages says so: `latched`",
    ),
    Bug(
        "unsubscribes for all when one closes",
        _subscriptions.Subscriptions,
        "remove",
        lambda original: lambda table, receiver: (original(table, receiver), True)[1],
        EndingRules.test_nothing_is_delivered_after_closing,
        "1 of 2 messages came",
    ),
    Bug(
        "leaves the connection open when it is closed",
        _link.BrokerConnection,
        "close",
        nothing,
        EndingRules.test_no_thread_and_no_descriptor_stays_behind,
        "left over",
    ),
    Bug(
        "leaves the thread of each source behind",
        ReceiveQueue,
        "close",
        nothing,
        EndingRules.test_no_thread_and_no_descriptor_stays_behind,
        "threads are left over",
    ),
    Bug(
        "leaves the sockets behind that wake paho",
        _client.BrokerClient,
        "release",
        nothing,
        EndingRules.test_no_thread_and_no_descriptor_stays_behind,
        "file descriptors are left over",
    ),
    Bug(
        "describes a topic for which no schema stands",
        _bridge.MqttBridge,
        "_refuse",
        nothing,
        Describing.test_what_is_not_there_is_named,
        "expected NOT_FOUND or UNAVAILABLE",
    ),
    Bug(
        "opens a topic for which no schema stands",
        _bridge.MqttBridge,
        "_require_there",
        nothing,
        Describing.test_what_is_not_there_does_not_open,
        "DID NOT RAISE",
    ),
    Bug(
        "gives a caller the reply to another request",
        _channels.ServiceCalls,
        "_take",
        the_first_reply,
        ServiceRules.test_several_threads_may_call_at_once,
        "the reply to {'value'",
    ),
    Bug(
        "describes services without a reply",
        _bridge.MqttBridge,
        "_description",
        without_a_reply,
        ServiceRules.test_a_service_is_described_by_request_and_reply,
        "it is described without a reply",
    ),
    Bug(
        "serves on after the close",
        _channels.ServedTopic,
        "_close",
        nothing,
        ServiceRules.test_a_served_function_answers_until_it_is_closed,
        "DID NOT RAISE",
    ),
    Bug(
        "answers with nothing when a served function raises",
        _channels.ServedTopic,
        "__init__",
        never_failing,
        ServiceRules.test_a_served_function_that_raises_fails_its_caller,
        "DID NOT RAISE",
    ),
)
"""What a careful engineer gets wrong with a broker, and the kit finds."""


def table() -> str:
    """Return the table of the page: bug, the rule that catches it, what the test says."""
    rows = [f"| {bug.name} | {rule_of(bug.caught)} | `{bug.says}` |" for bug in BUGS]
    head = "| the bridge | the rule that catches it | the test says |"
    return "\n".join([head, "|---|---|---|", *rows])
