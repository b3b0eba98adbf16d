"""Does every message arrive whole, once, in order, and one at a time, and does every call?

Calls come back, fail and end in time; served functions and links can be reached.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial
from typing import Any, ClassVar

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError, UoarmError
from uoarm.model import Endpoint, Message
from uoarm.testing._instances import instances
from uoarm.testing._waiting import Background, Collector, same, wait
from uoarm.testing.conformance._world import (
    Served,
    World,
    examples_of_service,
    find_other_type,
    hold_bridge_idle,
    hold_idle_between,
    line,
    rules,
    supplied,
    with_half,
    with_integers,
    with_length,
)

_MANY = 200
_SETTINGS: dict[str, Any] = {
    "deadline": None,
    "report_multiple_bugs": False,
    "suppress_health_check": (HealthCheck.too_slow, HealthCheck.data_too_large),
}


@rules("the-steps")
class Flow:
    """Messages on their way through one bridge, in and out."""

    kinds: ClassVar[tuple[str, ...]] = ()

    def test_every_message_of_the_structure_survives(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        with line(world, bridge, kind) as through:

            @settings(**_SETTINGS)
            @given(instances(through.structure.schema))
            def survives(message: Message) -> None:
                through.carries_or_refuses(message)

            survives()

    def test_what_is_long_survives(self, world: World, bridge: Bridge, kind: str) -> None:
        """Texts and lists of 300, and then 70,000 octets, where the structure sets no limit.

        Of 70,000 no buffer of 64 KiB holds all at once.
        """
        with line(world, bridge, kind) as through:
            for octets in (300, 70_000):
                message = with_length(through.structure.schema, through.example(), octets)
                through.carries_or_refuses(message)

    def test_values_arrive_with_their_types(self, world: World, bridge: Bridge, kind: str) -> None:
        """Octets as bytes, integers as int, truth values as bool."""
        with line(world, bridge, kind) as through:

            @settings(max_examples=20, **_SETTINGS)
            @given(instances(through.structure.schema))
            def keeps(message: Message) -> None:
                message = with_integers(through.structure.schema, message)
                if world.takes(kind, message):
                    (came,) = through.carries(message)
                    wrong = find_other_type(through.structure.schema, came)
                    assert not wrong, wrong

            keeps()

    def test_kinds_do_not_mix(self, world: World, bridge: Bridge, kind: str) -> None:
        others = [other for other in self.kinds if other != kind]
        if not others:
            pytest.skip("the world has one kind")
        with line(world, bridge, kind) as through, line(world, bridge, others[0]) as other:
            through.carries(through.example())
            other.carries(other.example())
            for item in (through, other):
                came = item.collector.messages
                assert len(came) == 1, f"what was sent elsewhere came, too: {came}"

    def test_a_retained_message_comes_first(self, world: World, bridge: Bridge) -> None:
        retained = supplied(world.retained(), "the world retains nothing")
        message, collector = retained.emit(), Collector()
        structure = bridge.describe(retained.source).message
        assert structure is not None
        source = bridge.open_source(retained.source, structure, collector.deliver)
        came = collector.wait(1, world.patience)
        assert same(came[0], message), f"{message!r} is retained, {came[0]!r} came"
        assert source.latched, "what retains messages says so: `latched`"
        source.close()

    def test_bursts_keep_their_order(self, world: World, bridge: Bridge, kind: str) -> None:
        with line(world, bridge, kind) as through:
            kept: list[Message] = []

            @settings(max_examples=10, **_SETTINGS)
            @given(st.lists(instances(through.structure.schema), min_size=2, max_size=8))
            def keeps(messages: list[Message]) -> None:
                taken = [message for message in messages if world.takes(kind, message)]
                kept.extend(world.carried(kind, message) for message in taken)
                through.carries(*taken)

            keeps()
            assert through.collector.overlaps == 0
            # A consumer may keep a message: what comes later must not write over it.
            for sent, came in zip(kept, through.collector.messages, strict=True):
                assert same(came, sent), f"{sent!r} came, and became {came!r} afterwards"

    def test_recorded_samples_survive(self, world: World, bridge: Bridge, kind: str) -> None:
        samples = world.samples(kind)
        if not samples:
            pytest.skip("the world has no samples of this kind")
        with line(world, bridge, kind) as through:
            for message in samples:
                through.carries(message)

    def test_the_first_message_after_opening_arrives(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        for _ in range(5):
            with line(world, bridge, kind) as through:
                through.carries(through.example())

    def test_a_line_opens_and_closes_many_times(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        for _ in range(20):
            with line(world, bridge, kind) as through:
                assert bridge.open_channels == len({through.sink, through.source})
            assert bridge.open_channels == 0

    def test_nothing_is_lost_or_doubled_in_a_stream(
        self, world: World, bridge: Bridge, kind: str
    ) -> None:
        with line(world, bridge, kind) as through:
            message = through.example()
            for _ in range(_MANY // 10):
                through.carries(*[message] * 10)
            assert through.collector.overlaps == 0
            assert len(through.collector.messages) == _MANY

    def test_two_receivers_get_the_same(self, world: World, bridge: Bridge, kind: str) -> None:
        world.await_receivers(kind, 0)
        with line(world, bridge, kind) as first, line(world, bridge, kind) as second:
            world.await_receivers(kind, 2)
            for count in (1, 2):  # what comes twice comes before the second
                first.send(first.example())
                for receiver in (first, second):
                    came = receiver.collector.wait(count, world.patience)
                    assert len(came) == count, f"{count} were sent, {len(came)} came"

    def test_what_waits_takes_hardly_any_processor_time(self, world: World, bridge: Bridge) -> None:
        """Before the first message, while few pass, after them, and after channels were closed."""
        world.await_receivers(self.kinds[0], 0)
        with line(world, bridge, self.kinds[0]):
            hold_bridge_idle(world, bridge, "before the first message")
            with line(world, bridge, self.kinds[0]) as through:
                world.await_receivers(self.kinds[0], 2)
                through.carries(through.example())
                hold_idle_between(through, bridge)
                hold_bridge_idle(world, bridge, "after the last message")
            hold_bridge_idle(world, bridge, "after channels were closed")


def _places_of_service(world: World) -> tuple[Endpoint, Endpoint]:
    """Return where a function can be served and called, or skip the test."""
    return supplied(world.servable(), "the bridge does not serve")


def _hold_failing_once(world: World, bridge: Bridge, fail: Callable[[], Message]) -> None:
    """Hold that a served function that fails fails its caller, and answers the next one."""
    offered, called = _places_of_service(world)
    replies: list[Message] = []
    channel = bridge.serve(offered, lambda _: replies[0] if replies else fail())
    request, reply = examples_of_service(bridge, called)
    with pytest.raises(BridgeError):
        bridge.call(called, request, timeout=_FAILING_SECONDS)
    replies.append(reply)
    again = Background(lambda: bridge.call(called, request)).result(world.patience)
    assert same(again, reply)
    channel.close()


_CALLERS = 8
_SHORT_SECONDS = 0.5
_FAILING_SECONDS = 2.0  # a framework without a form for failures lets the caller wait


@rules("the-steps")
class ServiceRules:
    """`call`, `serve` and `link`."""

    kinds: ClassVar[tuple[str, ...]] = ()

    @pytest.fixture
    def served(self, world: World) -> Served:
        """The world's service, or a skip where there is none."""
        return supplied(world.served(), "the world has no service")

    def test_a_service_is_described_by_request_and_reply(
        self, bridge: Bridge, served: Served
    ) -> None:
        description = bridge.describe(served.endpoint)
        assert description.request is not None, "it is described without a request"
        assert description.reply is not None, "it is described without a reply"

    def test_a_call_returns_the_reply(self, bridge: Bridge, served: Served) -> None:
        reply = bridge.call(served.endpoint, served.request)
        assert same(reply, served.reply), f"the reply is {reply!r}, expected {served.reply!r}"

    def test_several_threads_may_call_at_once(
        self, world: World, bridge: Bridge, served: Served
    ) -> None:
        """Each gets the reply to its own request."""
        wanted = [*served.more, (served.request, served.reply)]
        pairs = [wanted[number % len(wanted)] for number in range(_CALLERS)]
        calls = [Background(partial(bridge.call, served.endpoint, request)) for request, _ in pairs]
        for call, (request, reply) in zip(calls, pairs, strict=True):
            came = call.result(world.patience)
            assert same(came, reply), f"the reply to {request!r} is {came!r}, expected {reply!r}"

    def test_a_service_that_fails_is_a_bridge_error(self, bridge: Bridge, served: Served) -> None:
        failing = supplied(served.failing, "the world has no service that fails")
        with pytest.raises(BridgeError) as caught:
            bridge.call(failing, served.request)
        assert str(caught.value)
        assert same(bridge.call(served.endpoint, served.request), served.reply)

    def test_a_service_that_is_silent_ends_in_time(
        self, world: World, bridge: Bridge, served: Served
    ) -> None:
        silent = supplied(served.silent, "the world has no service that is silent")
        limit = world.patience + _SHORT_SECONDS
        # Reaching what it calls takes time of its own, of which the short limit has none to spare.
        bridge.call(served.endpoint, served.request)
        with pytest.raises(BridgeTimeoutError):
            Background(lambda: bridge.call(silent, served.request, timeout=_SHORT_SECONDS)).result(
                limit
            )
        # The framework may not have answered yet, and holds up no other call.
        reply = Background(lambda: bridge.call(served.endpoint, served.request)).result(
            world.patience
        )
        assert same(reply, served.reply), f"the reply is {reply!r}, expected {served.reply!r}"

    def test_a_call_that_is_late_ends_in_the_bridge_too(
        self, world: World, bridge: Bridge, served: Served
    ) -> None:
        """The core gives it up at once; its thread stays as long as `_call` does."""
        silent = served.silent
        if silent is None or world.runs_code:
            pytest.skip("nothing ends a call to a service that is silent in this world")
        bridge.call(served.endpoint, served.request)  # as above
        with pytest.raises(BridgeTimeoutError):
            bridge.call(silent, served.request, timeout=_SHORT_SECONDS)
        under_way = bridge._pending_calls  # noqa: SLF001 - which steps run is the core's
        wait(lambda: not len(under_way), "`_call` goes on after its timeout", world.patience)

    def test_a_call_that_waits_for_its_reply_ends_as_its_bridge_closes(
        self, world: World, served: Served
    ) -> None:
        silent = supplied(served.silent, "the world has no service that is silent")
        bridge, limit = world.bridge(), 4 * world.patience
        under_way = bridge._pending_calls  # noqa: SLF001 - as above
        try:
            calling = Background(lambda: bridge.call(silent, served.request, timeout=limit))
            wait(lambda: len(under_way), "the call did not begin", world.patience)
            bridge.call(served.endpoint, served.request)  # so that the other one is on its way
        finally:
            Background(bridge.close).result(world.patience)
        with pytest.raises(BridgeError) as caught:
            calling.result(world.patience)
        assert not isinstance(caught.value, BridgeTimeoutError), caught.value
        if not world.runs_code:
            wait(lambda: not len(under_way), "`_call` goes on after the close", world.patience)

    def test_what_the_bridge_cannot_do_is_refused(self, world: World, bridge: Bridge) -> None:
        endpoint = world.missing()
        able = bridge.capabilities
        for capable, step in (
            (able.call, lambda: bridge.call(endpoint, {})),
            (able.serve, lambda: bridge.serve(endpoint, lambda message: message)),
            (able.discover, bridge.discover),
        ):
            if not capable:
                with pytest.raises(BridgeError) as caught:
                    step()
                assert caught.value.reason is FailureReason.UNSUPPORTED

    def test_a_served_function_answers_until_it_is_closed(
        self, world: World, bridge: Bridge
    ) -> None:
        offered, called = _places_of_service(world)
        requests: list[Message] = []

        def answer(request: Message) -> Message:
            requests.append(request)
            return reply

        channel = bridge.serve(offered, answer)
        request, reply = examples_of_service(bridge, called)
        assert same(bridge.call(called, request), reply)
        assert same(requests, [request])
        channel.close()
        with pytest.raises(BridgeError):
            bridge.call(called, request, timeout=_SHORT_SECONDS)
        assert len(requests) == 1, "the function was called after the close"

    def test_a_function_can_be_served_again(self, world: World, bridge: Bridge) -> None:
        offered, called = _places_of_service(world)
        replies: list[Message] = []
        for _ in range(2):
            channel = bridge.serve(offered, lambda _: replies[-1])
            request, reply = examples_of_service(bridge, called)
            replies.append(reply)
            assert same(bridge.call(called, request), reply)
            channel.close()

    def test_a_served_function_that_takes_its_time_holds_up_nothing_else(
        self, world: World, bridge: Bridge
    ) -> None:
        offered, called = _places_of_service(world)
        begun, may_go_on = threading.Event(), threading.Event()

        def answer(_: Message) -> Message:
            begun.set()
            may_go_on.wait()
            return reply

        channel = bridge.serve(offered, answer)
        request, reply = examples_of_service(bridge, called)
        with line(world, bridge, self.kinds[0]) as through:
            calling = Background(lambda: bridge.call(called, request, timeout=world.patience))
            try:
                assert begun.wait(world.patience), "the function was not called"
                carrying = Background(lambda: through.carries(through.example()))
                carrying.result(2 * world.patience)
                Background(lambda: bridge.describe(called)).result(world.patience)
            finally:
                may_go_on.set()
            assert same(calling.result(world.patience), reply)
        channel.close()

    def test_a_served_function_that_raises_fails_its_caller(
        self, world: World, bridge: Bridge
    ) -> None:
        def fail() -> Message:
            raise ArithmeticError("the handler raises")

        _hold_failing_once(world, bridge, fail)

    def test_a_served_function_whose_reply_fits_nothing_fails_its_caller(
        self, world: World, bridge: Bridge
    ) -> None:
        _hold_failing_once(world, bridge, lambda: {"no_such_field_anywhere": object()})

    def test_a_request_that_fits_nothing_is_refused_in_words(
        self, world: World, bridge: Bridge, served: Served
    ) -> None:
        if world.runs_code:
            pytest.skip("what a function raises is its own")
        with pytest.raises((BridgeError, MessageError)) as caught:
            bridge.call(served.endpoint, {"no_such_field_anywhere": object()})
        reason = getattr(caught.value, "reason", None)
        assert reason is not FailureReason.RAISED, f"{caught.value} came by itself, and not of it"
        assert same(bridge.call(served.endpoint, served.request), served.reply)

    def test_a_request_with_text_that_cannot_be_encoded_ends_in_words(
        self, world: World, bridge: Bridge, served: Served
    ) -> None:
        endpoint, example = served.text or (served.endpoint, served.request)
        request = bridge.describe(endpoint).request
        assert request is not None
        broken = with_half(request.schema, example)
        if broken == example:
            pytest.skip("no request to the world's services has text")
        bridge.call(endpoint, example)
        try:
            bridge.call(endpoint, broken, timeout=world.patience)
        except BridgeTimeoutError:
            raise
        except UoarmError as error:
            str(error).encode()
        assert same(bridge.call(served.endpoint, served.request), served.reply)

    def test_a_link_carries_messages_without_the_manager(
        self, world: World, bridge: Bridge
    ) -> None:
        pair = supplied(world.linkable(), "the world has nothing to link")
        channel = bridge.link(pair.source, pair.sink)
        assert channel is not None
        channel.close()
        assert bridge.open_channels == 0

    def test_a_call_to_what_is_not_there_is_an_error(self, world: World, bridge: Bridge) -> None:
        if not bridge.capabilities.call:
            pytest.skip("the bridge does not call")
        with pytest.raises(BridgeError) as caught:
            bridge.call(world.missing(), {}, timeout=_SHORT_SECONDS)
        reason = caught.value.reason
        assert reason is not FailureReason.RAISED, f"{caught.value} came by itself, and not of it"
