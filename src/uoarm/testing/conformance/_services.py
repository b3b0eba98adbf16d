"""Do calls come back, fail and end in time, and are served functions and links reachable?"""

from __future__ import annotations

from functools import partial

import pytest

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm.model import Message
from uoarm.testing._collector import Background, same
from uoarm.testing.conformance._world import Served, World, example_of, rules

__all__ = ["ServiceRules"]

_CALLERS = 8
_SHORT_SECONDS = 0.5
_FAILING_SECONDS = 2.0  # a framework without a form for failures lets the caller wait


@rules("the-steps")
class ServiceRules:
    """`call`, `serve` and `link`."""

    @pytest.fixture
    def served(self, world: World) -> Served:
        """The world's service, or a skip where there is none."""
        found = world.served()
        if found is None:
            pytest.skip("the world has no service")
        return found

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
        if served.failing is None:
            pytest.skip("the world has no service that fails")
        with pytest.raises(BridgeError) as caught:
            bridge.call(served.failing, served.request)
        assert str(caught.value)
        assert same(bridge.call(served.endpoint, served.request), served.reply)

    def test_a_service_that_is_silent_ends_in_time(
        self, world: World, bridge: Bridge, served: Served
    ) -> None:
        silent = served.silent
        if silent is None:
            pytest.skip("the world has no service that is silent")
        limit = world.patience + _SHORT_SECONDS
        with pytest.raises(BridgeTimeoutError):
            Background(lambda: bridge.call(silent, served.request, timeout=_SHORT_SECONDS)).result(
                limit
            )
        # The framework may not have answered yet, and holds up no other call.
        reply = Background(lambda: bridge.call(served.endpoint, served.request)).result(
            world.patience
        )
        assert same(reply, served.reply), f"the reply is {reply!r}, expected {served.reply!r}"

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
        places = world.servable()
        if places is None:
            pytest.skip("the bridge does not serve")
        offered, called = places
        requests: list[Message] = []

        def answer(request: Message) -> Message:
            requests.append(request)
            return reply

        channel = bridge.serve(offered, answer)
        description = bridge.describe(called)
        assert description.request is not None
        assert description.reply is not None
        request, reply = example_of(description.request), example_of(description.reply)
        assert same(bridge.call(called, request), reply)
        assert same(requests, [request])
        channel.close()
        with pytest.raises(BridgeError):
            bridge.call(called, request, timeout=_SHORT_SECONDS)

    def test_a_served_function_that_raises_fails_its_caller(
        self, world: World, bridge: Bridge
    ) -> None:
        places = world.servable()
        if places is None:
            pytest.skip("the bridge does not serve")
        offered, called = places
        replies: list[Message] = []

        def answer(_: Message) -> Message:
            if replies:
                return replies[0]
            raise ArithmeticError("the handler raises")

        channel = bridge.serve(offered, answer)
        description = bridge.describe(called)
        assert description.request is not None
        assert description.reply is not None
        request = example_of(description.request)
        with pytest.raises(BridgeError):
            bridge.call(called, request, timeout=_FAILING_SECONDS)
        replies.append(example_of(description.reply))
        again = Background(lambda: bridge.call(called, request)).result(world.patience)
        assert same(again, replies[0])
        channel.close()

    def test_a_link_carries_messages_without_the_manager(
        self, world: World, bridge: Bridge
    ) -> None:
        pair = world.linkable()
        if pair is None:
            pytest.skip("the world has nothing to link")
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
