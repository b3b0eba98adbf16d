"""The contract's final methods: limits, late results, foreign exceptions, plugins that break."""

from __future__ import annotations

import ast
import threading
from collections.abc import Callable
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from uoarm import _bounded
from uoarm.bridge import Bridge, BridgeType, Channel, Description, Registry, Sink
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, PluginError
from uoarm.model import BridgeSpec, Deliver, Endpoint, Message, MessageStructure, Role
from uoarm.testing import patience

ROOT = Path(__file__).parents[2]
ENDPOINT = Endpoint("b", "c", Role.OUTPUT, ("x",))
ANY = MessageStructure({})


class Link(Sink):
    def __init__(self, endpoint: Endpoint, close: Callable[[], None]) -> None:
        super().__init__(endpoint)
        self._on_close = close

    def send(self, message: Message) -> None:
        del message

    def _close(self) -> None:
        self._on_close()


class Puppet(Bridge):
    """Does in each step what the test says."""

    def __init__(self) -> None:
        super().__init__("b", {})
        self.step: Callable[[], object] = lambda: None
        self.closed_links: list[str] = []
        self.closing: Callable[[], None] = lambda: self.closed_links.append("closed")

    def _describe(self, endpoint: Endpoint) -> Description:
        self.step()
        return Description(ANY)

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Deliver
    ) -> Channel:
        self.step()
        return Link(endpoint, self.closing)

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


def test_a_bridge_that_hangs_is_given_up_and_what_opens_late_is_closed() -> None:
    bridge, gate, closed = Puppet(), threading.Event(), threading.Event()
    bridge.step = lambda: gate.wait(patience())
    bridge.closing = closed.set
    with pytest.raises(BridgeTimeoutError, match=r"within 0\.05 s"):
        bridge.open_source(ENDPOINT, ANY, lambda _: None, timeout=0.05)
    gate.set()
    assert closed.wait(patience())
    assert bridge.open_channels == 0


def test_a_bridge_that_lies_about_its_results_is_told_so() -> None:
    bridge = Puppet()
    with pytest.raises(BridgeError, match="breaks the contract") as caught:
        bridge.open_sink(ENDPOINT, ANY)
    assert caught.value.reason is FailureReason.CONTRACT


def test_closing_closes_channels_first_and_only_once() -> None:
    bridge = Puppet()
    channel = bridge.open_source(ENDPOINT, ANY, lambda _: None)
    bridge.close()
    bridge.close()
    channel.close()
    assert bridge.closed_links == ["closed"]
    with pytest.raises(BridgeError, match="is closed"):
        bridge.describe(ENDPOINT)


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
        _bounded.run("the quick step", 5, lambda: None)
        _bounded.run("the stuck step", 0.05, lambda: gate.wait(patience()))

    with pytest.raises(BridgeTimeoutError, match="the stuck step"):
        _bounded.run("the whole", 30, outer)
    gate.set()


def test_inner_steps_share_the_outer_thread() -> None:
    threads: list[int] = []

    def outer() -> None:
        threads.append(threading.get_ident())
        _bounded.run("inner", 5, lambda: threads.append(threading.get_ident()))

    _bounded.run("outer", 5, outer)
    assert len(set(threads)) == 1
    assert threads[0] != threading.get_ident()


def point(name: str, module: str) -> EntryPoint:
    return EntryPoint(name, module, "uoarm.bridges")


def test_a_broken_plugin_is_reported_and_hurts_nobody() -> None:
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
    assert "contract" in problem.cause


@pytest.mark.parametrize("folder", ["plugins", "src/uoarm/cli/template", "src/uoarm/local"])
def test_what_we_ship_states_its_contract_version_as_a_number(folder: str) -> None:
    """A version that is imported from the core would agree with any core."""
    stated = [
        {one.arg: one.value for one in call.keywords}.get("contract")
        for file in (ROOT / folder).rglob("src/**/*.py" if folder == "plugins" else "**/*.py")
        for call in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(call, ast.Call) and getattr(call.func, "id", "") == "BridgeType"
    ]
    assert stated
    assert all(isinstance(one, ast.Constant) and one.value == 1 for one in stated)


def test_a_missing_plugin_says_what_to_install() -> None:
    with pytest.raises(PluginError, match=r"pip install .*uoarm-rtm$"):
        Registry([]).create(BridgeSpec("r", "rtm"))
