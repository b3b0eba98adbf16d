"""The conformance kit against a real broker: each deliberate bug makes a test of it fail."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from brokers import Broker, running
from bugs import BUGS, Bug, table
from mqtt_world import KINDS, MqttWorld
from test_conformance import TestMqttBridge
from tests.harness._kit import kit_skips  # type: ignore[import-not-found]
from tests.testing.bad_worlds import Bug as GeneralBug  # type: ignore[import-not-found]
from tests.testing.kit_bugs import GENERAL as EVERY  # type: ignore[import-not-found]
from tests.testing.kit_bugs import hold_found_out, rules_without_a_bug
from uoarm_mqtt import _link

from uoarm.bridge import ReceiveQueue
from uoarm.errors import BridgeError
from uoarm.testing._waiting import default_limits
from uoarm.testing.conformance._world import PAGE, rule_of

# A broker links no topics. Its connection reports by itself: `BUGS` has what is wrong there.
_ELSEWHERE = {
    "makes no link, though it says that it can",
    "blames the other end of a link for a death",
    "says that all is lost when one component dies",
    "does not report that the link is broken",
    "does not report that the link is mended",
    "says no cause of the break",
    "reports each break twice",
    "reports a break of inputs alone",
    "reports a break under a lock that its facts take",
    "reports that all is well while it still connects",
}
GENERAL = [bug for bug in EVERY if bug.name not in _ELSEWHERE]


class ImpatientWorld(MqttWorld):
    """A world in which most bugs show by what does not come: that is not waited for long.

    Connecting again takes its time: in a world that breaks, nothing is to be missed for it.
    """

    is_lasting = True

    @property
    def patience(self) -> float:
        return 1.5 if self.is_lasting else 10.0


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Close in the end what some of the bugs leave open."""
    opened: list[Any] = []

    def noting(init: Any) -> Any:
        def noted(made: Any, *given: Any, **named: Any) -> None:
            opened.append(made)
            init(made, *given, **named)

        return noted

    for owner in (_link.BrokerConnection, ReceiveQueue):
        monkeypatch.setattr(owner, "__init__", noting(owner.__init__))
    yield
    for item in opened:
        item.close()


@pytest.mark.long
@pytest.mark.usefixtures("made")
@pytest.mark.parametrize("bug", BUGS, ids=lambda bug: bug.name.replace(" ", "-"))
def test_a_bad_bridge_is_found_out(bug: Bug, broker: Broker, tmp_path: Path) -> None:
    wanted = inspect.signature(bug.caught).parameters
    breaks = bug.caught.__qualname__.startswith("Breaking.")
    with running(tmp_path / "broker") if breaks else nullcontext(broker) as used:
        world = ImpatientWorld(used)
        world.is_lasting = not breaks
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(bug.owner, bug.part, bug.replace(getattr(bug.owner, bug.part)))
            bridge = world.bridge()
            given: dict[str, Any] = {"world": world, "bridge": bridge, "kind": "nested"}
            given["self"] = SimpleNamespace(kinds=tuple(KINDS), hosted=False)
            if "served" in wanted:
                given["served"] = world.served()
            try:
                with pytest.raises(AssertionError) as caught, default_limits(5.0):
                    bug.caught(**{name: given[name] for name in wanted})
            finally:
                with suppress(BridgeError):  # one of the bugs
                    bridge.close()
        world.close()
    text = str(caught.value)
    assert bug.says in text, text
    assert f"the rule is: {rule_of(bug.caught)} ({PAGE}#" in text


@pytest.mark.long
@pytest.mark.parametrize("bug", GENERAL, ids=lambda bug: bug.name.replace(" ", "-"))
def test_a_bug_that_any_bridge_may_have_is_found_out(
    bug: GeneralBug, broker: Broker, tmp_path: Path
) -> None:
    breaks = bug.caught.__qualname__.startswith("Breaking.")

    @contextmanager
    def opened() -> Iterator[MqttWorld]:
        with running(tmp_path / "broker") if breaks else nullcontext(broker) as used:
            world = type("OwnWorld", (MqttWorld,), {})(used)
            try:
                yield world
            finally:
                world.close()

    suite = TestMqttBridge()
    hold_found_out(bug, opened, suite, "text" if bug.pair == "text" else "nested")


def test_each_rule_that_a_broker_can_break_has_a_bug() -> None:
    skipped = {skip.rule for skip in kit_skips() if skip.bridge == "mqtt" and not skip.kinds}
    assert rules_without_a_bug((*GENERAL, *BUGS)) <= skipped


def test_the_page_has_the_table() -> None:
    page = Path(__file__).with_name("bugs.md").read_text(encoding="utf-8")
    assert table() in page, f"put this into bugs.md:\n{table()}"
