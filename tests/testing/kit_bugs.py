"""Deliberate bugs that break each promise of the conformance kit in a plugin's own bridge.

A bug of `bad_bridges` replaces a step of a bridge, and so fits any of them. A plugin has further
ones for what only its framework can get wrong; with these, every rule of the kit is broken once.
"""

from __future__ import annotations

import inspect
import os
import threading
import weakref
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import pytest
from tests.testing.bad_bridges import BUGS
from tests.testing.bad_descriptions import declares
from tests.testing.bad_endings import joins_its_delivery, queued
from tests.testing.bad_messages import loses_the_first
from tests.testing.bad_moments import reports_under_a_lock
from tests.testing.bad_services import CALL_BUGS, noting_breaks
from tests.testing.bad_worlds import (
    BLOCKING,
    CLOSING,
    LINKS,
    MESSAGES,
    OPTIONS_KIND,
    SERVICES,
    WORDS,
    Bug,
    Spoil,
    delivering,
    noting_deliveries,
    sending,
    source,
    step,
)

from uoarm.bridge import Bridge, Description, Discovered, Registry, Source
from uoarm.errors import UoarmError
from uoarm.model import Endpoint, Message, Role
from uoarm.testing import MemoryBridge
from uoarm.testing._waiting import default_limits
from uoarm.testing.conformance import BridgeConformance, World
from uoarm.testing.conformance._describing import Declaring, Describing
from uoarm.testing.conformance._ending import EndingRules
from uoarm.testing.conformance._failures import Breaking, DisturbanceRules
from uoarm.testing.conformance._flow import Flow, ServiceRules
from uoarm.testing.conformance._world import PAGE, rule_of

NOTHING_COMES = 0.5  # seconds after which nothing comes of most bugs
LONGER = (1, 4, 16, 64)  # times as long as that, on a machine that is slow or busy
HANGING = 5.0

_OF_THE_MEMORY = {
    "delivers -1 for 255",
    "takes zeros and empty texts for no message",
    "delivers octets as a list",
    "delivers integers as floats",
    "delivers truth values as 0 and 1",
    "cuts texts after four characters",
    "writes texts in ASCII",
    "rounds numbers",
    "delivers the first three items only",
    "closes all channels with one",
    "closes all bridges with one",
    "discovers what cannot be described",
    "reports the break with each retry",
    "connects again and does not subscribe again",
    "subscribes again to what it is subscribed to",
    "closes only once the link is mended",
    "opens while the link is broken, for nothing",
    "leaves degraded what opened while the link was broken",
    "takes options that it does not know",
    "takes any value of an option",
    "does not hand its options on",
    "says that send returns at once, and blocks",
    "makes one call at a time",
    "waits in closing for the delivery that closes",
    "says that it is drained while messages wait",
    "reports under a lock that its facts take",
}
"""Bugs that are made of what only the memory bridge has; below are others of their kind."""


class _Text(str):
    """A text of a framework's own class."""

    __slots__ = ()


def _closes_all(world: Any, bridge: Any) -> None:
    opened: list[Source] = []

    def change(_: Any, __: Any, made: Source) -> None:
        opened.append(made)

        def close() -> None:
            for channel in opened:
                type(channel)._close(channel)

        made._close = close  # type: ignore[method-assign]

    source(change)(world, bridge)


def _closes_all_bridges(world: Any, bridge: Any, close: Any) -> Any:
    def closed() -> None:
        for made in world.bridges:
            type(made)._close(made)

    return closed


def _ghost(world: Any, bridge: Any, discover: Any) -> Any:
    endpoint = Endpoint(bridge.name, "ghost", Role.OUTPUT, ("ghost",))
    return lambda: (*discover(), Discovered("ghost", ((endpoint, Description()),)))


def _closes_once_mended(world: Any, bridge: Any) -> None:
    broken = noting_breaks(bridge)

    def change(_: Any, __: Any, made: Source) -> None:
        def close() -> None:
            while broken.is_set() and not world.ended.wait(0.01):
                pass
            type(made)._close(made)

        made._close = close  # type: ignore[method-assign]

    source(change)(world, bridge)


def _opens_for_nothing(world: Any, bridge: Any) -> None:
    broken, opens = noting_breaks(bridge), bridge._open_source
    bridge._open_source = lambda endpoint, *more: (
        Source(endpoint, lambda: None) if broken.is_set() else opens(endpoint, *more)
    )


def _reports_twice(world: Any, bridge: Any, report: Any) -> Any:
    def reported(*given: Any, **about: Any) -> None:
        report(*given, **about)
        report(*given, **about)

    return reported


def _waits_for_consumers(world: Any, bridge: Any) -> None:
    """Have `send` return only when nothing is being delivered."""
    delivering_now = noting_deliveries(world, bridge)

    def waits(send: Any) -> Any:
        def sent(message: Message) -> None:
            send(message)
            delivering_now.wait(0.1)
            while delivering_now.is_set() and not world.ended.wait(0.01):
                pass

        return sent

    sending(waits)(world, bridge)


def _any_value(world: Any) -> Any:
    schema = world.declared.options_schema
    return {**schema, "properties": {name: {} for name in schema["properties"]}}


def _forgets_options(world: Any) -> Any:
    create = world.declared.create

    def made(name: str, options: Any) -> Bridge:
        bridge: Any = create(name, options)
        bridge.options = {}
        return bridge  # type: ignore[no-any-return]

    return made


def _needs_what_it_does_not_require(world: Any) -> Any:
    def create(name: str, options: Any) -> Bridge:
        for option in world.declared.options_schema["required"]:
            options[option]
        raise AssertionError("never: one is left out")

    return create


GENERAL: tuple[Bug, ...] = (
    *(bug for bug in BUGS if bug.name not in _OF_THE_MEMORY),
    *CALL_BUGS,
    Bug(
        MESSAGES,
        "cuts texts after 255 characters",
        delivering(lambda deliver: lambda message: deliver(message[:255])),
        Flow.test_what_is_long_survives,
        "sent 'long",
        "text",
    ),
    Bug(
        MESSAGES,
        "loses what is longer than 64 KiB",
        delivering(
            lambda deliver: lambda message: deliver(message) if len(message) < 65_536 else None
        ),
        Flow.test_what_is_long_survives,
        "1 of 2 messages came",
        "text",
    ),
    Bug(
        MESSAGES,
        "delivers texts of a class of its own",
        delivering(lambda deliver: lambda message: deliver(_Text(message))),
        Flow.test_values_arrive_with_their_types,
        "a _Text where the structure says string",
        "text",
    ),
    Bug(
        MESSAGES,
        "loses what was recorded",
        delivering(loses_the_first),
        Flow.test_recorded_samples_survive,
        "0 of 1 messages came",
    ),
    Bug(
        CLOSING,
        "closes every source with one",
        _closes_all,
        EndingRules.test_nothing_is_delivered_after_closing,
        "1 of 2 messages came",
    ),
    Bug(
        CLOSING,
        "closes every bridge with one",
        step("_close", _closes_all_bridges),
        EndingRules.test_bridges_live_side_by_side,
        "",
    ),
    Bug(
        CLOSING,
        "says that it is drained while most messages wait",
        queued(drains=lambda _, __: True, pause=0.5),
        EndingRules.test_what_drain_says_to_have_arrived_arrives,
        "messages came",
    ),
    Bug(
        CLOSING,
        "waits in closing for the delivery that asked for it",
        joins_its_delivery,
        EndingRules.test_a_source_can_be_closed_from_its_own_delivery,
        "closing from within a delivery did not return",
    ),
    Bug(
        WORDS,
        "discovers a component that is not there",
        step("_discover", _ghost),
        Describing.test_discovered_components_can_be_described,
        "ghost",
    ),
    Bug(
        LINKS,
        "reports a break under a lock that its facts take",
        reports_under_a_lock,
        Breaking.test_a_break_is_reported_of_an_output_that_is_open_alone,
        "it was not reported",
    ),
    Bug(
        LINKS,
        "reports each break twice",
        step("report", _reports_twice),
        Breaking.test_a_break_is_reported_with_its_cause_and_so_is_its_end,
        "reported again",
    ),
    Bug(
        LINKS,
        "closes a source only once the link is mended",
        _closes_once_mended,
        Breaking.test_what_is_broken_can_be_closed,
        "still running",
    ),
    Bug(
        LINKS,
        "opens what carries nothing while the link is broken",
        _opens_for_nothing,
        Breaking.test_what_opens_while_it_is_broken_carries_once_it_is_mended,
        "0 of 1 messages came",
    ),
    Bug(
        BLOCKING,
        "has send wait for the consumer",
        _waits_for_consumers,
        DisturbanceRules.test_a_sink_that_does_not_block_returns_while_a_consumer_is_stuck,
        "still running",
    ),
    Bug(
        SERVICES,
        "makes no link, though it says that it can",
        step("_link", lambda *_: lambda source, sink: None),
        ServiceRules.test_a_link_carries_messages_without_the_manager,
        "None",
    ),
    Bug(
        OPTIONS_KIND,
        "takes whatever options there are",
        declares(bridge_options=lambda world: {"type": "object"}),
        Declaring.test_an_option_that_is_not_known_is_refused,
        "",
    ),
    Bug(
        OPTIONS_KIND,
        "takes any value of its options",
        declares(bridge_options=_any_value, create=lambda _: MemoryBridge),
        Declaring.test_an_option_of_a_wrong_type_is_refused,
        "",
    ),
    Bug(
        OPTIONS_KIND,
        "forgets its options",
        declares(create=_forgets_options),
        Declaring.test_the_options_reach_the_bridge,
        ", got {}",
    ),
    Bug(
        OPTIONS_KIND,
        "needs an option that it does not require",
        declares(
            bridge_options=lambda world: {**world.declared.options_schema, "required": []},
            create=_needs_what_it_does_not_require,
        ),
        Declaring.test_an_option_that_is_required_is_missed,
        "is needed, and not required",
    ),
    Bug(
        OPTIONS_KIND,
        "has nothing to say of itself",
        declares(summary=""),
        Declaring.test_the_plugin_states_the_contract_of_this_uoarm,
        "summary",
    ),
)
_RULED_OUT = {
    "a closed sink refuses messages",
    "what the bridge cannot do is refused",
    "a line opens and closes many times",
}
"""Rules that the core holds for every bridge."""


class Spoiled:
    """What a bug uses of a world: where what it leaves behind ends, and what it declares."""

    def __init__(self, world: World, spoil: Spoil, seconds: float) -> None:
        self.world, self.spoil, self.seconds = world, spoil, seconds
        self.ended = threading.Event()
        self.leaks: list[tuple[int, int]] = []
        self.bridges: list[Bridge] = []
        self.channels: list[Callable[[], Any]] = []  # weak, as a rule is about who holds them
        self.is_declared = spoil.__name__.startswith("declares")
        spec = world.spec()
        assert spec is not None
        self.declared = world.registry().types[spec.plugin]

    def registry(self) -> Registry:
        """Return what the world's registry has, with the plugin as the bug declares it."""
        made = Registry([])
        made.add(self.declared)
        return made

    def spoiled(self, bridge: Bridge) -> Bridge:
        """Put the bug into a bridge."""
        self.bridges.append(bridge)
        for name in ("_open_source", "_open_sink", "_serve", "_link"):
            setattr(bridge, name, self._noting(getattr(bridge, name)))
        if not self.is_declared:
            self.spoil(self, bridge)  # type: ignore[arg-type] # as good as a `BadWorld`
        return bridge

    def _noting(self, opens: Any) -> Any:
        def opened(*given: Any) -> Any:
            channel = opens(*given)
            self.channels.append(weakref.ref(channel))
            return channel

        return opened

    def close(self) -> None:
        """End what the bug left behind."""
        self.ended.set()
        for reference in self.channels:
            channel = reference()
            with suppress(Exception):  # it was closed, or is not there
                type(channel)._close(channel)
        for bridge in self.bridges:
            with suppress(Exception):  # one of the bugs
                bridge.close()
            with suppress(Exception):
                type(bridge)._close(bridge)
        for ends in self.leaks:
            for end in ends:
                os.close(end)


@contextmanager
def spoiled(world: World, spoil: Spoil, seconds: float) -> Iterator[Spoiled]:
    """Have the bridges of a world have a bug, and its patience be so short, while a block runs."""
    state = Spoiled(world, spoil, seconds)
    if state.is_declared:
        spoil(state, None)  # type: ignore[arg-type] # before there is a bridge
    make = world.bridge
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(world, "registry", state.registry)
        patch.setattr(world, "bridge", lambda: state.spoiled(make()), raising=False)
        patch.setattr(type(world), "patience", property(lambda _: seconds))
        try:
            yield state
        finally:
            state.close()


def hold_found_out(
    bug: Bug, open_world: Callable[[], Any], suite: BridgeConformance, kind: str
) -> None:
    """Hold that a test of the kit fails with a bug, says what it should, and not without the bug.

    Args:
        bug: the bug.
        open_world: a context manager that gives a new world.
        suite: the plugin's own.
        kind: of the pair that the test is run with.
    """
    text = ""
    for times in LONGER:
        raised = _run(bug.caught, bug.spoil, open_world, suite, kind, times)
        text = str(raised)
        # On a machine that is starved the time is over before the bug shows, or without one.
        if bug.says in text and _run(bug.caught, _none, open_world, suite, kind, times) is None:
            break
    else:
        pytest.fail(f"this is found out where the bug is and where it is not:\n{text}")
    assert isinstance(raised, AssertionError)
    assert f"the rule is: {rule_of(bug.caught)} ({PAGE}#" in text


def _none(*_: object) -> None:
    """Leave a bridge as it is."""


def _run(
    test: Callable[..., None],
    spoil: Spoil,
    open_world: Callable[[], Any],
    suite: BridgeConformance,
    kind: str,
    times: int,
) -> BaseException | None:
    wanted = inspect.signature(test).parameters
    with open_world() as world, spoiled(world, spoil, times * NOTHING_COMES) as state:
        given: dict[str, Any] = {"self": suite, "world": world, "kind": kind}
        given |= {"spec": world.spec(), "declared": state.declared}
        with default_limits(times * HANGING):
            try:
                if "bridge" in wanted:
                    given["bridge"] = world.bridge()
                if "served" in wanted:
                    given["served"] = world.served()
                test(**{name: given[name] for name in wanted})
            except (AssertionError, UoarmError) as error:
                return error
    return None


def rules_without_a_bug(bugs: Iterable[Any]) -> set[str]:
    """Return the rules of the kit that none of these bugs breaks, but those that the core holds."""
    every = {
        rule_of(getattr(BridgeConformance, name))
        for name in dir(BridgeConformance)
        if name.startswith("test_")
    }
    return every - {rule_of(bug.caught) for bug in bugs} - _RULED_OUT
