"""The contract's final methods: limits, late results, foreign exceptions, plugins that break."""

from __future__ import annotations

import ast
import math
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest
from attrs import evolve

from uoarm._support import deadlines
from uoarm.bridge import (
    Bridge,
    BridgeType,
    Capabilities,
    Channel,
    Delivery,
    Description,
    Discovered,
    Handler,
    HealthEvent,
    Registry,
    ServiceStructures,
    Sink,
    Source,
)
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, PluginError
from uoarm.model import (
    BridgeSpec,
    CommandPolicy,
    Endpoint,
    Health,
    Message,
    MessageStructure,
    Role,
    StopMessage,
)
from uoarm.testing import Background, Collector, lying, patience, wait

ROOT = Path(__file__).parents[2]
ENDPOINT = Endpoint("b", "c", Role.OUTPUT, ("x",))
ANY = MessageStructure({})


class Puppet(Bridge):
    """Does in each step what the test says."""

    def __init__(self) -> None:
        super().__init__("b", {})
        self.step: Callable[[], object] = lambda: None
        self.deliver: Any = lambda _: None
        self.closed_links: list[str] = []
        self.closing: Callable[[], None] = lambda: self.closed_links.append("closed")

    def _describe(self, endpoint: Endpoint) -> Description:
        self.step()
        return Description(ANY)

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        self.deliver = deliver
        self.step()
        return Source(endpoint, self.closing)

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        return self.step()  # type: ignore[return-value] # a lie, on purpose

    def _close(self) -> None:
        self.step()


def fail() -> None:
    raise ZeroDivisionError("native trouble")


def test_what_a_bridge_raises_is_translated_with_its_cause() -> None:
    bridge = Puppet()
    bridge.step = fail
    with pytest.raises(BridgeError, match=r"describing .*native trouble") as caught:
        bridge.describe(ENDPOINT)
    assert caught.value.reason is FailureReason.RAISED
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


class Unsure(Puppet):
    """Raises when it is asked in which thread its steps may run."""

    capabilities = Capabilities(call=True)

    def _is_quick(self, endpoint: Endpoint) -> bool:
        fail()
        return True

    _keeps_time = _is_quick


@pytest.mark.parametrize(
    "ask",
    [
        lambda bridge: bridge.is_quick(ENDPOINT),
        lambda bridge: bridge.open_source(ENDPOINT, ANY, lambda _: None),
        lambda bridge: bridge.open_sink(ENDPOINT, ANY),
        lambda bridge: bridge.call(ENDPOINT, {}),
    ],
)
def test_what_a_bridge_raises_when_asked_for_its_thread_is_translated(
    ask: Callable[[Bridge], object],
) -> None:
    with pytest.raises(BridgeError, match="native trouble") as caught:
        ask(Unsure())
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


def test_a_bridge_that_hangs_is_given_up_and_what_opens_late_is_closed() -> None:
    bridge, gate, closed = Puppet(), threading.Event(), threading.Event()
    bridge.step = lambda: gate.wait(patience())
    bridge.closing = closed.set
    with pytest.raises(BridgeTimeoutError, match=r"within 0\.05 s"):
        bridge.open_source(ENDPOINT, ANY, lambda _: None, timeout=0.05)
    gate.set()
    assert closed.wait(patience())
    assert bridge.open_channels == 0


def test_a_bridge_that_lies_about_its_results_is_refused() -> None:
    bridge = Puppet()
    with pytest.raises(BridgeError, match="breaks the contract") as caught:
        bridge.open_sink(ENDPOINT, ANY)
    assert caught.value.reason is FailureReason.CONTRACT


@pytest.mark.parametrize("part", ["message", "request", "reply"])
def test_a_description_of_something_else_is_refused(part: str) -> None:
    class Describing(Puppet):
        def _describe(self, endpoint: Endpoint) -> Description:
            wrong: Any = {part: {"type": "integer"}}
            return Description(**wrong)

    with pytest.raises(
        BridgeError, match=r"_describe returned dict, expected .* MessageStructures"
    ):
        Describing().describe(ENDPOINT)


@pytest.mark.parametrize(
    ("discovered", "expected"),
    [
        (lambda: None, "discovering components failed: TypeError"),
        (lambda: [1], "breaks the contract: _discover returned int"),
        (lambda: [Discovered("x", ((ENDPOINT, ANY),))], "_discover returned MessageStructure"),  # type: ignore[arg-type]
        (lambda: [Discovered("x", [1])], "discovering components failed: TypeError"),  # type: ignore[arg-type]
    ],
)
def test_a_bridge_that_discovers_something_else_is_refused(
    discovered: Callable[[], Any], expected: str
) -> None:
    class Discovering(Puppet):
        capabilities = Capabilities(discover=True)

        def _discover(self) -> tuple[Discovered, ...]:
            return discovered()  # type: ignore[no-any-return]

    with pytest.raises(BridgeError, match=expected):
        Discovering().discover()


def test_closing_closes_channels_first_and_only_once() -> None:
    bridge = Puppet()
    channel = bridge.open_source(ENDPOINT, ANY, lambda _: None)
    bridge.close()
    bridge.close()
    channel.close()
    assert bridge.closed_links == ["closed"]
    with pytest.raises(BridgeError, match="is closed"):
        bridge.describe(ENDPOINT)


@pytest.mark.parametrize("first", ["bridge", "channel"])
def test_a_close_of_a_bridge_from_within_does_not_wait_for_itself(first: str) -> None:
    bridge = Puppet()
    again = partial(bridge.close, timeout=threading.TIMEOUT_MAX)
    bridge.closing = again
    channel = bridge.open_source(ENDPOINT, ANY, lambda _: None)
    bridge.step = again
    (bridge if first == "bridge" else channel).close(timeout=patience())
    assert bridge.open_channels == 0


def test_a_close_that_fails_still_counts_as_closed() -> None:
    bridge = Puppet()
    bridge.closing = fail
    channel = bridge.open_source(ENDPOINT, ANY, lambda _: None)
    with pytest.raises(BridgeError, match="native trouble"):
        channel.close()
    assert channel.closed
    assert bridge.open_channels == 0


def test_what_a_bridge_cannot_do_is_refused_by_name() -> None:
    with pytest.raises(BridgeError, match="cannot call services") as caught:
        Puppet().call(ENDPOINT, {})
    assert caught.value.reason is FailureReason.UNSUPPORTED


def test_an_inner_step_that_hangs_is_the_one_that_is_named() -> None:
    gate = threading.Event()

    def outer() -> None:
        deadlines.run("the quick step", patience(), lambda: None)
        deadlines.run("the stuck step", 0.05, lambda: gate.wait(patience()))

    with pytest.raises(BridgeTimeoutError, match="the stuck step"):
        deadlines.run("the whole", 2 * patience(), outer)
    gate.set()


def test_who_waits_for_the_outer_step_goes_on_when_an_isolated_one_is_given_up() -> None:
    gate = threading.Event()

    def outer() -> str:
        with pytest.raises(BridgeTimeoutError, match="the stuck step"):
            deadlines.run("the stuck step", 0.05, gate.wait, isolated=True)
        return "done"

    assert deadlines.run("the whole", patience(), outer) == "done"
    gate.set()


def test_an_isolated_step_that_hangs_is_named_when_the_outer_one_is_given_up() -> None:
    gate, begun = threading.Event(), threading.Event()

    def hang() -> None:
        begun.set()
        gate.wait()

    def isolated() -> None:
        deadlines.run("the stuck step", patience(), hang)

    def outer() -> None:
        deadlines.run("the isolated step", math.inf, isolated, isolated=True)

    whole = deadlines._Job("the whole", 5, outer, None, None, 0.0)
    whole.deadline = math.inf
    threading.Thread(target=whole.work).start()
    assert begun.wait(patience())
    whole.deadline = 0.0
    with pytest.raises(BridgeTimeoutError, match="the stuck step did not finish within 5 s"):
        whole._wait()
    gate.set()


def test_the_name_of_a_step_is_put_together_only_where_it_is_shown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    reports: list[Endpoint] = []

    def counted(endpoint: Endpoint) -> str:
        reports.append(endpoint)
        return "the camera"

    monkeypatch.setattr(Endpoint, "__str__", counted)
    # Where steps of other tests hang still, each name is looked up among theirs.
    monkeypatch.setattr(deadlines, "_hanging", deadlines._Hanging())
    bridge = Puppet()
    bridge.open_source(ENDPOINT, ANY, lambda _: None).close()
    assert not reports
    bridge.step = fail
    with pytest.raises(BridgeError, match="bridge 'b': opening the camera failed: ZeroDivision"):
        bridge.open_source(ENDPOINT, ANY, lambda _: None)
    assert reports == [ENDPOINT]


def test_inner_steps_share_the_outer_thread() -> None:
    threads: list[int] = []

    def outer() -> None:
        threads.append(threading.get_ident())
        deadlines.run("inner", 5, lambda: threads.append(threading.get_ident()))

    deadlines.run("outer", 5, outer)
    assert len(set(threads)) == 1
    assert threads[0] != threading.get_ident()


def test_a_step_that_no_thread_waits_for_ends_in_its_own_or_is_given_up() -> None:
    ended: list[object] = []
    quick = deadlines.begin("the quick step", lambda: 1, lambda *end: ended.append(end))
    wait(lambda: ended == [(1, None)], "it did not end")
    assert quick.give_up_late() is None

    gate, came = threading.Event(), threading.Event()

    def outer() -> None:
        try:
            deadlines.run("the stuck step", 0.01, lambda: gate.wait(patience()))
        finally:
            came.set()

    late = deadlines.begin("the whole", outer, lambda *end: ended.append(end))
    errors: list[object] = []

    def is_given_up() -> bool:
        errors.append(late.give_up_late())
        return errors[-1] is not None

    wait(is_given_up, "it was not given up")
    assert "the stuck step did not finish within 0.01 s" in str(errors[-1])
    assert late.give_up_late() is None
    gate.set()
    wait(came.is_set, "it hangs still")
    assert len(ended) == 1


def point(name: str, module: str) -> EntryPoint:
    return EntryPoint(name, module, "uoarm.bridges")


def test_a_broken_plugin_is_reported_and_hurts_no_other() -> None:
    registry = Registry([point("broken", "no_such_module_at_all"), point("python", "uoarm.local")])
    assert list(registry.types) == ["python"]
    (problem,) = registry.problems
    assert "no_such_module_at_all" in problem.cause
    with pytest.raises(PluginError, match="cannot be used"):
        registry.create(BridgeSpec("x", "broken"))


def test_a_module_without_the_hook_is_a_problem() -> None:
    registry = Registry([point("empty", "json")])
    assert "no uoarm_bridge_types" in registry.problems[0].cause


def test_another_contract_version_is_refused_by_number() -> None:
    registry = Registry([])
    with pytest.raises(PluginError, match="version 99"):
        registry.add(BridgeType("x", "", lambda *_: Puppet(), contract=99))


def test_a_plugin_that_states_no_contract_version_is_a_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "unstated.py").write_text(
        "from uoarm.bridge import BridgeType, hookimpl\n"
        "@hookimpl\n"
        "def uoarm_bridge_types():\n"
        "    return [BridgeType(name='x', summary='', create=lambda *_: None)]\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    registry = Registry([point("unstated", "unstated")])
    assert not registry.types
    [problem] = registry.problems
    assert "bridge type 'x' states no contract version: add `contract=`" in problem.cause


@pytest.mark.parametrize("folder", ["plugins", "src/uoarm/cli/template", "src/uoarm/local"])
def test_what_we_ship_states_its_contract_version_as_a_number(folder: str) -> None:
    """A version that is imported from the core would agree with any core."""
    stated = [
        {keyword.arg: keyword.value for keyword in call.keywords}.get("contract")
        for file in (ROOT / folder).rglob("src/**/*.py" if folder == "plugins" else "**/*.py")
        if "BridgeType" in (source := file.read_text(encoding="utf-8"))
        for call in ast.walk(ast.parse(source))
        if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "BridgeType"
    ]
    assert stated
    assert all(isinstance(expr, ast.Constant) and expr.value == 2 for expr in stated)


def test_a_missing_plugin_says_what_to_install() -> None:
    with pytest.raises(PluginError, match=r"pip install .*uoarm-rtm'?$"):
        Registry([]).create(BridgeSpec("r", "rtm"))


def test_no_message_is_delivered_once_a_channel_is_closed() -> None:
    """A bridge need not see to it: what it delivers too late is counted and goes nowhere."""
    bridge, got = Puppet(), list[Message]()
    channel = bridge.open_source(ENDPOINT, ANY, got.append)
    bridge.deliver(1)
    channel.close()
    bridge.deliver(2)
    assert got == [1]
    assert channel.refused == 1


def test_what_cannot_be_read_is_counted_and_handed_on_until_the_channel_is_closed() -> None:
    bridge, got = Puppet(), Collector()
    channel = bridge.open_source(ENDPOINT, ANY, got)
    bridge.deliver.readable()  # of which nothing follows before the first that cannot be read
    bridge.deliver.unreadable("x" * 2000)
    bridge.deliver.unreadable("")
    bridge.deliver.unreadable(EOFError("cut short"))
    bridge.deliver.readable()
    bridge.deliver(1)
    assert got.unread == ["x" * 1000, "it cannot be read", "EOFError: cut short", ""]
    assert got.messages == [1]
    channel.close()
    bridge.deliver.unreadable("late")
    bridge.deliver.readable()
    assert channel.unreadable == 3
    assert len(got.unread) == 4


def test_a_health_by_its_name_is_that_health_and_another_name_is_refused_where_it_is_given() -> (
    None
):
    bridge, events = Puppet(), list[HealthEvent]()
    bridge.watch(events.append)
    name: Any = "lost"
    bridge.report(name, "it is gone")
    assert events[-1].health is Health.LOST
    with pytest.raises(ValueError, match="'dead' is not a valid Health"):
        bridge.report("dead", "it is gone")  # type: ignore[arg-type]
    assert len(events) == 1


@pytest.mark.parametrize("take", [Collector, list], ids=["delivery", "function"])
def test_a_silence_names_what_came_and_could_not_be_read(take: Callable[[], Any]) -> None:
    bridge, got, events = Puppet(), take(), list[HealthEvent]()
    bridge.watch(events.append)
    channel = bridge.open_source(ENDPOINT, ANY, got if callable(got) else got.append)

    def reported_cause(health: Health = Health.LOST) -> str:
        bridge.report(health, "no message for 5 s", channel=channel)
        return events[-1].cause

    assert reported_cause() == "no message for 5 s"
    bridge.deliver.unreadable("cut short")
    assert (
        reported_cause()
        == "no message for 5 s; the last message that came cannot be read: cut short"
    )
    assert reported_cause(Health.FINISHED) == reported_cause(Health.OK) == "no message for 5 s"
    bridge.report(Health.LOST, "it is cut short again", channel=channel)
    assert events[-1].cause == "it is cut short again"
    bridge.deliver.readable()
    assert reported_cause() == "no message for 5 s"
    bridge.deliver.unreadable("cut short")
    bridge.deliver(1)
    assert reported_cause() == "no message for 5 s"


def test_a_bridge_that_keeps_the_limit_of_a_call_says_what_it_waited_for() -> None:
    class Waiting(Puppet):
        capabilities = Capabilities(call=True)

        def _call(
            self,
            endpoint: Endpoint,
            structures: ServiceStructures,
            message: Message,
            timeout: float,
        ) -> Message:
            threading.Event().wait(timeout)
            raise BridgeTimeoutError("no reply; what came answers no call")

    with pytest.raises(BridgeTimeoutError, match="what came answers no call"):
        Waiting().call(ENDPOINT, 1, timeout=0.05)


def test_what_cannot_be_read_is_counted_where_a_function_takes_the_messages() -> None:
    bridge, got = Puppet(), list[Message]()
    channel = bridge.open_source(ENDPOINT, ANY, got.append)
    bridge.deliver.unreadable("cut short")
    bridge.deliver.readable()
    assert (channel.unreadable, got) == (1, [])


def test_no_message_is_delivered_from_what_did_not_open() -> None:
    bridge, got = Puppet(), list[Message]()
    bridge.step = fail
    with pytest.raises(BridgeError):
        bridge.open_source(ENDPOINT, ANY, got.append)
    bridge.deliver(1)
    assert got == []


def test_no_message_is_delivered_once_the_bridge_is_closed() -> None:
    bridge, got = Puppet(), list[Message]()
    bridge.open_source(ENDPOINT, ANY, got.append)
    bridge.close()
    bridge.deliver(1)
    assert got == []


def test_a_bridge_may_deliver_from_several_threads_at_once() -> None:
    bridge, collector = Puppet(), Collector()
    bridge.open_source(ENDPOINT, ANY, collector.deliver)
    with collector.held():
        threads = [Background(lambda: bridge.deliver(1)) for _ in range(8)]
        collector.wait_begun(1)
    for thread in threads:
        thread.result()
    assert (len(collector.messages), collector.overlaps) == (8, 0)


def test_closing_does_not_wait_for_a_delivery_that_lasts() -> None:
    bridge, collector = Puppet(), Collector()
    channel = bridge.open_source(ENDPOINT, ANY, collector.deliver)
    with collector.held():
        thread = Background(lambda: bridge.deliver(1))
        collector.wait_begun(1)
        Background(channel.close).result()
    thread.result()


def test_a_channel_may_be_closed_from_its_own_delivery() -> None:
    bridge = Puppet()
    channel: Channel = bridge.open_source(ENDPOINT, ANY, lambda _: channel.close())
    Background(lambda: bridge.deliver(1)).result()
    assert channel.closed


def test_a_plain_sink_sends_until_it_is_closed() -> None:
    sent, closed = list[Message](), list[str]()
    sink = Sink(ENDPOINT, sent.append, lambda: closed.append("closed"), blocking=False)
    sink.send(1)
    sink.close()
    sink.close()
    with pytest.raises(BridgeError, match="is closed") as caught:
        sink.send(2)
    assert caught.value.reason is FailureReason.CLOSED
    assert (sent, closed, sink.blocking) == ([1], ["closed"], False)


def test_a_channel_without_a_way_to_close_it_cannot_be_made() -> None:
    with pytest.raises(TypeError, match="Source: pass a function `close`, or override `_close`"):
        Source(ENDPOINT)
    with pytest.raises(TypeError, match="Sink: pass a function `send`, or override `_send`"):
        Sink(ENDPOINT, close=lambda: None)


def test_an_output_must_be_opened_as_a_source() -> None:
    bridge = Puppet()
    with (
        lying(bridge, "_open_source", Channel(ENDPOINT, lambda: None)),
        pytest.raises(BridgeError, match="returned Channel, expected a Source") as caught,
    ):
        bridge.open_source(ENDPOINT, ANY, lambda _: None)
    assert caught.value.reason is FailureReason.CONTRACT


def test_a_bridge_that_knows_no_structures_need_not_describe() -> None:
    class Bare(Puppet):
        _describe = Bridge._describe

    assert Bare().describe(ENDPOINT) == Description()


class Prompt(Puppet):
    """Calls in the caller's thread where the endpoint is of the component `prompt`."""

    capabilities = Capabilities(call=True)

    def __init__(self) -> None:
        super().__init__()
        self.threads: list[threading.Thread] = []

    def _keeps_time(self, endpoint: Endpoint) -> bool:
        return endpoint.component == "prompt"

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        self.threads.append(threading.current_thread())
        return self.step()


@pytest.mark.parametrize("component", ["prompt", "other"])
def test_a_call_that_keeps_its_time_stays_in_the_thread_of_the_caller(component: str) -> None:
    bridge, endpoint = Prompt(), Endpoint("b", component, Role.SERVICE, ("x",))
    bridge.step = lambda: "reply"
    assert bridge.call(endpoint, "request") == "reply"
    assert (bridge.threads == [threading.current_thread()]) is (component == "prompt")
    bridge.step = fail
    with pytest.raises(BridgeError, match=r"calling .*native trouble") as caught:
        bridge.call(endpoint, "request")
    assert caught.value.reason is FailureReason.RAISED
    bridge.cancel_call(7)
    with pytest.raises(BridgeError, match="cancelled before it began"):
        bridge.call(endpoint, "request", number=7)
    reports: list[str] = []

    def cancelled() -> str:
        with bridge.cancelling(lambda: reports.append("cancelled")):
            assert bridge.cancel_call(8)
        return "ended early"

    bridge.step = cancelled
    assert bridge.call(endpoint, "request", number=8) == "ended early"
    assert reports == ["cancelled"]

    def cancelled_with_an_error() -> None:
        cancelled()
        fail()

    bridge.step = cancelled_with_an_error
    with pytest.raises(BridgeError, match="native trouble") as caught:
        bridge.call(endpoint, "request", number=8)
    assert caught.value.reason is FailureReason.REFUSED  # the service is not to blame
    bridge.step = lambda: None
    bridge.close()
    with pytest.raises(BridgeError, match="is closed"):
        bridge.call(endpoint, "request")


def test_a_bridge_that_is_closed_cancels_all_calls_under_way() -> None:
    """Also after one that cannot be cancelled, which the close reports."""
    bridge, endpoint = Prompt(), Endpoint("b", "prompt", Role.SERVICE, ("x",))
    is_cancelled = threading.Event()

    def begin(cancel: Callable[[], object]) -> Future[object]:
        is_waiting = threading.Event()

        def wait_for_the_end() -> str:
            with bridge.cancelling(cancel):
                is_waiting.set()
                assert is_cancelled.wait(patience())
            return "ended early"

        bridge.step = wait_for_the_end
        called = pool.submit(bridge.call, endpoint, "request")
        assert is_waiting.wait(patience())
        return called

    with ThreadPoolExecutor() as pool:
        calls = [begin(fail), begin(is_cancelled.set)]
        bridge.step = lambda: None
        with pytest.raises(BridgeError, match=r"cancelling calls.*native trouble"):
            bridge.close()
        assert [call.result(patience()) for call in calls] == ["ended early"] * 2


class Within(Prompt):
    """Has each call in a step of its own, as a function has that calls another one."""

    def _keeps_time(self, endpoint: Endpoint) -> bool:
        return False


def test_a_caller_waits_for_no_call_that_outlasts_the_bridge() -> None:
    bridge, is_waiting, may_end = Within(), threading.Event(), threading.Event()

    def hang() -> str:
        is_waiting.set()
        assert may_end.wait(2 * patience())
        return "late"

    def call() -> Message:
        endpoint = Endpoint("b", "arm", Role.SERVICE, ("x",))
        return bridge.call(endpoint, "request", timeout=2 * patience())

    def call_from_a_loop() -> Message:
        step = deadlines.begin("a call", call, lambda *_: None)
        error = None
        while error is None:
            error = step.give_up_late()
        raise error

    for way in (call, call_from_a_loop):
        bridge = Within()
        bridge.step = hang
        is_waiting.clear()
        calling = Background(way)
        assert is_waiting.wait(patience())
        bridge.step = lambda: None
        bridge.close()
        with pytest.raises(BridgeError, match=r"calling .* given up: the bridge was closed") as got:
            calling.result()
        assert got.value.reason is FailureReason.CLOSED
    may_end.set()
    wait(lambda: not any(" of arm at" in step for step in deadlines._hanging.steps))


def test_a_call_that_outlasts_one_bridge_is_still_waited_for_by_another() -> None:
    bridge, inner, may_end = Within(), Within(), threading.Event()
    endpoint, is_waiting = Endpoint("b", "arm", Role.SERVICE, ("x",)), threading.Event()

    def hold() -> str:
        is_waiting.set()
        assert may_end.wait(2 * patience())
        return "inner"

    def call_another() -> tuple[str, dict[object, float]]:
        reply: str = inner.call(endpoint, "request", timeout=2 * patience())
        step = deadlines.current()
        assert step is not None
        return reply, dict(step.abandoned)

    inner.step, bridge.step = hold, call_another
    call = Background(lambda: bridge.call(endpoint, "request", timeout=2 * patience()))
    assert is_waiting.wait(patience())
    inner._pending_calls.abandon(2 * patience())  # as its close does, with a longer grace
    may_end.set()
    assert call.result() == ("inner", {})


def test_a_call_that_closes_its_own_bridge_returns() -> None:
    bridge, endpoint = Within(), Endpoint("b", "arm", Role.SERVICE, ("x",))

    def close() -> dict[object, float]:
        bridge.step = lambda: None
        bridge.close()
        step = deadlines.current()
        assert step is not None
        return step.abandoned

    bridge.step = close
    assert bridge.call(endpoint, "request", timeout=patience()) == {}


def test_no_call_begins_once_its_bridge_is_closed() -> None:
    class Closing(Prompt):
        def _keeps_time(self, endpoint: Endpoint) -> bool:
            Background(self.close).result()  # between the look whether it is, and the call
            return super()._keeps_time(endpoint)

    for component in ("prompt", "other"):
        bridge = Closing()
        bridge.step = lambda: None
        with pytest.raises(BridgeError, match="the bridge was closed") as caught:
            bridge.call(Endpoint("b", component, Role.SERVICE, ("x",)), "request")
        assert caught.value.reason is FailureReason.CLOSED
        assert bridge.threads == []


def test_a_call_that_cannot_be_cancelled_is_late_all_the_same(
    caplog: pytest.LogCaptureFixture,
) -> None:
    bridge, endpoint, may_end = (
        Within(),
        Endpoint("b", "arm", Role.SERVICE, ("x",)),
        threading.Event(),
    )

    def hang() -> str:
        with bridge.cancelling(fail):
            assert may_end.wait(patience())
        return "late"

    bridge.step = hang
    with pytest.raises(BridgeTimeoutError, match="did not finish within"):
        bridge.call(endpoint, "request", timeout=0.05)
    assert "could not be asked to end: ZeroDivisionError: native trouble" in caplog.text
    may_end.set()
    wait(lambda: not any(" of arm at" in step for step in deadlines._hanging.steps))


def test_no_stop_waits_for_a_call_that_is_being_cancelled() -> None:
    stop = StopMessage({"v": 0.0})
    moving = Endpoint("b", "base", Role.INPUT, ("x",), command=CommandPolicy(None, stop))
    bridge, is_stopped, is_waiting = Prompt(), threading.Event(), threading.Event()

    def take(message: Message) -> None:
        if message == stop.message:
            is_stopped.set()

    bridge.step = lambda: Sink(moving, take, lambda: None)
    bridge.open_sink(moving, ANY).send({"v": 0.5})

    def cancel() -> None:
        assert is_stopped.wait(patience())

    def wait_for_the_stop() -> str:
        with bridge.cancelling(cancel):
            is_waiting.set()
            assert is_stopped.wait(2 * patience())
        return "ended early"

    bridge.step = wait_for_the_stop
    endpoint = Endpoint("b", "prompt", Role.SERVICE, ("x",))
    call = Background(lambda: bridge.call(endpoint, "request"))
    assert is_waiting.wait(patience())
    bridge.step = lambda: None
    bridge.close(timeout=2 * patience())
    assert call.result() == "ended early"


class Quick(Puppet):
    """Opens and closes in the caller's thread where the endpoint is of the component `quick`."""

    def _is_quick(self, endpoint: Endpoint) -> bool:
        return endpoint.component == "quick"


@pytest.mark.parametrize("component", ["quick", "other"])
def test_what_is_quick_opens_and_closes_in_the_thread_of_the_caller(component: str) -> None:
    bridge, endpoint = Quick(), Endpoint("b", component, Role.OUTPUT, ("x",))
    threads: list[threading.Thread] = []
    bridge.step = bridge.closing = lambda: threads.append(threading.current_thread())
    bridge.open_source(endpoint, ANY, lambda _: None).close()
    assert [thread is threading.current_thread() for thread in threads] == 2 * [
        component == "quick"
    ]
    bridge.step = bridge.closing = fail
    with pytest.raises(BridgeError, match=r"opening .*native trouble"):
        bridge.open_source(endpoint, ANY, lambda _: None)
    bridge.step = lambda: None
    channel = bridge.open_source(endpoint, ANY, lambda _: None)
    with pytest.raises(BridgeError, match=r"closing .*native trouble"):
        channel.close()
    assert bridge.open_channels == 0


def test_what_moves_something_is_not_quick_as_its_stop_is_sent_when_it_closes() -> None:
    bridge = Quick()
    endpoint = Endpoint("b", "quick", Role.INPUT, ("x",))
    assert bridge.is_quick(endpoint)
    assert not bridge.is_quick(evolve(endpoint, command=CommandPolicy()))
    bridge.close()
    assert not bridge.is_quick(endpoint)


def test_calls_and_served_functions_are_given_their_structures() -> None:
    seen: list[object] = []
    structures = ServiceStructures(MessageStructure({"type": "integer"}), ANY)

    class Calls(Puppet):
        capabilities = Capabilities(call=True, serve=True)

        def _call(
            self,
            endpoint: Endpoint,
            structures: ServiceStructures,
            message: Message,
            timeout: float,
        ) -> Message:
            seen.append(structures)

        def _serve(
            self, endpoint: Endpoint, structures: ServiceStructures, handler: Handler
        ) -> Channel:
            seen.append(structures)
            return Channel(endpoint, lambda: None)

    bridge = Calls()
    bridge.call(ENDPOINT, 1, structures)
    bridge.serve(ENDPOINT, lambda message: message, structures)
    bridge.call(ENDPOINT, 1)
    assert seen == [structures, structures, ServiceStructures()]
