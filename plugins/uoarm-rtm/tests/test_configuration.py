"""Configuration sets: what is written is what the component has and allows, and is there after."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from typing import Any

import pytest
from endpoints import Start, endpoint
from uoarm_rtm import _servants
from uoarm_rtm._control import problem
from uoarm_rtm._orb import Orb
from uoarm_rtm._peer import pairs
from uoarm_rtm.component import ComponentProfile, RtComponent

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Role
from uoarm.testing import Background, patience, wait

AT = endpoint(Role.SERVICE, "Worker.rtc", "@configuration")
SETS = {
    "default": {"gain": "1", "mode": "slow"},
    "fast": {"gain": "9"},
    "plain": {"count": "0", "name": "hoge"},
}


def test_sets_are_read_written_and_activated(bridge: Bridge, peer: Start) -> None:
    component = peer("Worker")
    assert bridge.call(AT, {}) == {
        "active": "default",
        "sets": SETS,
        "constraints": {"gain": "0<=x<=150", "mode": "(slow,quick)"},
        "widgets": {"gain": "slider.10"},
    }
    assert bridge.call(AT, {"set": "fast", "activate": True})["active"] == "fast"
    assert component.configuration() == {"gain": "9"}
    bridge.call(AT, {"values": {"gain": "10"}})
    assert component.configuration() == {"gain": "10"}


def test_a_write_leaves_the_active_set_in_force(bridge: Bridge, peer: Start) -> None:
    component = peer("Worker")
    component.forget_sets()
    reply = bridge.call(AT, {"set": "fast", "values": {"gain": "8"}})
    assert (reply["active"], reply["sets"]["fast"]) == ("default", {"gain": "8"})
    reply = bridge.call(AT, {"values": {"gain": "2"}})
    assert (reply["active"], reply["sets"]["default"]["gain"]) == ("default", "2")


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (
            {"set": "fats", "values": {"gain": "2"}},
            "no configuration set 'fats'; there are default",
        ),
        ({"set": "fats", "activate": True}, "no configuration set 'fats'"),
        ({"values": {"gian": "2"}}, "no parameter 'gian'; there are count, gain, mode, name"),
        ({"values": {"gain": "abc"}}, r"\$\.values\.gain: expected a number, got 'abc'"),
        ({"values": {"gain": "151"}}, r"\$\.values\.gain: expected 0<=x<=150, got 151"),
        ({"values": {"mode": "fast"}}, r"\$\.values\.mode: expected one of \(slow,quick\)"),
        ({"values": ["gain"]}, "expected a table"),
    ],
    ids=str,
)
def test_what_does_not_fit_is_refused_and_nothing_written(
    bridge: Bridge, peer: Start, message: dict[str, Any], words: str
) -> None:
    peer("Worker")
    with pytest.raises(MessageError, match=words):
        bridge.call(AT, message)
    reply = bridge.call(AT, {})
    assert (reply["active"], reply["sets"]) == ("default", SETS)


def test_a_text_where_a_number_was_is_written_with_a_warning(
    bridge: Bridge, peer: Start, caplog: pytest.LogCaptureFixture
) -> None:
    peer("Worker")
    reply = bridge.call(AT, {"set": "plain", "values": {"count": "1e3, 5", "name": "7"}})
    assert "warnings" not in reply
    reply = bridge.call(AT, {"set": "plain", "values": {"count": "abc"}})
    assert reply["sets"]["plain"] == {"count": "abc", "name": "7"}
    (warning,) = reply["warnings"]
    assert "values.count: 'abc' is no number, which it was ('1e3, 5')" in warning
    assert warning in caplog.text


def test_a_new_set_is_made_where_that_is_asked(bridge: Bridge, peer: Start) -> None:
    component = peer("Worker")
    reply = bridge.call(AT, {"set": "new", "values": {"gain": "3"}, "create": True})
    assert reply["sets"]["new"] == {"gain": "3"}
    component.forget_sets()
    lost = {"set": "newer", "values": {"gain": "3"}, "create": True}
    with pytest.raises(BridgeError, match="took the set 'newer' without an error") as caught:
        bridge.call(AT, lost)
    assert caught.value.reason is FailureReason.REFUSED


@pytest.mark.parametrize(
    ("value", "constraint", "kind", "widget", "words"),
    [
        ("5", "x>4", "", "", ""),
        ("4", "x>4", "", "", "expected x>4"),
        ("4", "4<=x", "", "", ""),
        ("3.9", "4 <= x", "", "", "expected 4 <= x"),
        ("10", "0<=x<10", "", "", "expected 0<=x<10"),
        ("-1.5e0", "-2<x<2", "", "", ""),
        ("1,2,3", "0<=x<=2", "", "", "got 3"),
        ("1,20", "x<=2,x<=30", "", "", ""),
        ("3,20", "x<=2,x<=30", "", "", "got 3"),
        ("nan", "x>0", "", "", "expected a number"),
        ("abc", "", "int", "", "expected int, got 'abc'"),
        ("1.5", "", "int", "", "expected int, got '1.5'"),
        ("1.5", "", "double", "", ""),
        ("1,x", "", "std::vector<double>", "", "expected a number, got 'x'"),
        ("abc", "", "", "spin", "expected a number"),
        ("a", "(a,b)", "", "radio", ""),
        ("c", "(a,b)", "", "radio", "expected one of (a,b)"),
        ("a,b", "(a,b,c)", "", "checkbox", ""),
        ("anything", "whatever this is", "string", "text", ""),
        ("", "", "", "", ""),
    ],
)
def test_constraints(value: str, constraint: str, kind: str, widget: str, words: str) -> None:
    found = problem(value, constraint, kind, widget)
    assert bool(found) == bool(words)
    assert words in found


@pytest.fixture
def made() -> Iterator[tuple[Any, list[Mapping[str, str]]]]:
    """The configuration of a component here, and what it was notified of."""
    orb, notified = Orb("127.0.0.1", patience()), list[Mapping[str, str]]()
    component = RtComponent(
        orb,
        ComponentProfile("Own", configuration={"default": {"gain": "1"}, "fast": {"gain": "9"}}),
        configured=notified.append,
    )
    yield vars(component)["_configuration"], notified
    component.close()
    orb.close()


def test_a_set_that_is_removed_as_all_are_read_is_read_or_is_not(
    made: tuple[Any, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    servant, _ = made
    removing: list[Background[bool]] = []

    def read(values: Mapping[str, str]) -> list[Any]:
        if not removing:
            removing.append(Background(lambda: servant.remove_configuration_set("fast")))
            wait(lambda: "fast" not in servant._sets or servant._lock.locked())
        return pairs(values)

    monkeypatch.setattr(_servants, "pairs", read)
    assert [found.id for found in servant.get_configuration_sets()] == ["default", "fast"]
    assert removing[0].result()
    assert [found.id for found in servant.get_configuration_sets()] == ["default"]


def test_a_component_is_notified_last_of_what_is_in_force(
    made: tuple[Any, list[Mapping[str, str]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    servant, notified = made
    begun, go_on = threading.Event(), threading.Event()

    def configured(values: Mapping[str, str]) -> None:
        if values["gain"] == "9":
            begun.set()
            assert go_on.wait(patience())
        notified.append(values)

    monkeypatch.setattr(servant, "_changed", configured)
    first = Background(lambda: servant.activate_configuration_set("fast"))
    assert begun.wait(patience())
    then = Background(lambda: servant.activate_configuration_set("default"))
    wait(lambda: servant._active == "default")
    go_on.set()
    assert (first.result(), then.result()) == (True, True)
    assert [values["gain"] for values in notified] == ["9", "1"]
