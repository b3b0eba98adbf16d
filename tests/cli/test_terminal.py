"""Commands on a real terminal: messages, tables, colours, and text that would control it."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from tests.cli.terminal import on_a_terminal

from uoarm.cli._run import _LineLimit
from uoarm.testing import ManualClock

ROBOT = """
version: 1
bridges: {python: {}}
functions:
  count:
    components:
      - {name: counter, bridge: python, output: {endpoint: ["on_terminal:count"]}}
  doubled:
    components:
      - name: doubler
        bridge: python
        input: {from: count, endpoint: ["on_terminal:double"], queue: {policy: block, timeout: 30}}
        output: {endpoint: ["on_terminal:double"]}
  flood:
    components:
      - {name: flood, bridge: python, output: {endpoint: ["on_terminal:flood"]}}
  endless:
    components:
      - {name: endless, bridge: python, output: {endpoint: ["on_terminal:endless"]}}
  long:
    components:
      - {name: long, bridge: python, output: {endpoint: ["on_terminal:long"]}}
  hostile:
    components:
      - {name: hostile, bridge: python, output: {endpoint: ["on_terminal:hostile"]}}
"""
COMPONENTS = """
import threading
from collections.abc import Iterator
from typing import TypedDict
class Number(TypedDict):
    n: int
class Text(TypedDict):
    text: str
def count() -> Iterator[Number]:
    for n in range(3):
        yield {"n": n}
def double(m: Number) -> Number:
    return {"n": m["n"] * 2}
def flood() -> Iterator[Number]:
    for n in range(20_000):
        yield {"n": n}
def endless() -> Iterator[Number]:
    yield {"n": 77}
    threading.Event().wait()
def hostile() -> Iterator[Number]:
    raise RuntimeError("evil \\x1b[2J\\x1b]0;title\\x07 \\x9b31m \\u202e over\\rwritten")
def long() -> Iterator[Text]:
    yield {"text": "[red]" + "x" * 100_000}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "on_terminal.py").write_text(COMPONENTS)
    (tmp_path / "robot.yaml").write_text(ROBOT)
    return tmp_path


def messages(text: str) -> list[int]:
    """Return the numbers of the messages that stand on lines of their own."""
    return [json.loads(line)["n"] for line in text.splitlines() if line.startswith('{"n"')]


def test_the_messages_are_seen_and_the_table_counts_them(folder: Path) -> None:
    seen = on_a_terminal(["request", "doubled"], folder)
    assert seen.code == 0, seen.text
    assert messages(seen.text) == [0, 2, 4]
    [row] = [line for line in seen.last.splitlines() if "counter" in line]
    assert row.split().count("3") == 2, seen.last
    assert "3 messages" in seen.last


def test_a_message_is_on_screen_while_the_source_says_nothing_more(folder: Path) -> None:
    seen = on_a_terminal(["request", "endless"], folder, interrupt_at='{"n": 77}')
    assert seen.code == 130
    assert messages(seen.text) == [77]


def test_every_message_of_a_flood_is_shown_or_counted(folder: Path) -> None:
    """How many are shown depends on how fast they come: on a slow machine it may be all."""
    seen = on_a_terminal(["request", "flood"], folder)
    assert seen.code == 0, seen.text
    shown = len(messages(seen.text))
    assert shown
    last = " ".join(seen.last.split())
    [report] = re.findall(r"([\d,]+) messages(?:, ([\d,]+) of them not shown)?", last)
    received, hidden = (int(item.replace(",", "") or 0) for item in report)
    assert received == shown + hidden


def test_ten_messages_are_shown_in_a_quarter_of_a_second_and_the_others_counted() -> None:
    clock = ManualClock()
    shown = _LineLimit(clock)
    assert [shown.has_line() for _ in range(12)] == [True] * 10 + [False] * 2
    clock.advance(0.25)
    assert [shown.has_line() for _ in range(1_990)] == [True] * 10 + [False] * 1_980
    assert str(shown) == "2,002 messages, 1,982 of them not shown; --json writes all"


def test_a_long_message_takes_one_line_and_is_no_markup(folder: Path) -> None:
    seen = on_a_terminal(["request", "long"], folder, width=80)
    [line] = [line for line in seen.text.splitlines() if "[red]xxx" in line]
    assert len(line) <= 80
    assert line.endswith("…")


@pytest.mark.parametrize("width", [40, 60])
def test_on_a_narrow_terminal_flows_are_shown_in_full_in_lines(folder: Path, width: int) -> None:
    seen = on_a_terminal(["request", "doubled"], folder, width=width, height=20)
    assert seen.code == 0, seen.text
    [*_, flows] = seen.text.rpartition("counter.default")
    assert max(map(len, f"counter.default{flows}".splitlines())) <= width
    text = " ".join(flows.split())
    assert text.startswith("-> doubler.default received 3, delivered 3"), text
    assert text.endswith("3 messages"), text
    assert "…" not in seen.text


def test_on_a_narrow_terminal_what_goes_on_stands_below(folder: Path) -> None:
    (folder / "robot.yaml").write_text(ROBOT.replace("on_terminal:long", "nothing_of_this_name:x"))
    seen = on_a_terminal(["status"], folder, width=40)
    assert seen.code == 1, seen.text
    assert max(map(len, seen.text.splitlines())) <= 40
    assert "available\n" in seen.text
    [*_, text] = seen.text.partition("\n       0  long  (python)")
    assert text, seen.text
    _, *rest = text.splitlines()[:3]
    assert all(line.startswith(" " * 9) for line in rest), text
    assert "there is no module 'nothing_of_this_name'" in " ".join(text.split())


def test_text_of_a_component_does_not_control_the_terminal(folder: Path) -> None:
    seen = on_a_terminal(["request", "hostile"], folder, width=300)
    assert seen.code == 4, seen.text
    text = r"evil \x1b[2J\x1b]0;title\x07 \x9b31m \u202e over\rwritten"
    assert f"RuntimeError: {text}" in seen.raw


PLAIN = """
from uoarm.cli import main

for words in (["status"], ["list"], ["resolve", "nothing"], ["request", "count"]):
    try:
        main(words)
    except SystemExit:
        print(words, "has ended")
"""


def test_colours_are_for_terminals_that_have_them_and_who_wants_them(folder: Path) -> None:
    status = on_a_terminal(["status", "--watch", "--every", "0.1"], folder, interrupt_at="\x1b[2J")
    assert "\x1b[32m" in status.raw
    for variable, value in (("NO_COLOR", "1"), ("TERM", "dumb")):
        seen = on_a_terminal([], folder, program=("-c", PLAIN), environment={variable: value})
        assert seen.text.count("has ended") == 4, seen.text
        assert not re.search(r"\x1b\[[0-9;]*3[0-7]", seen.raw), seen.raw
        assert "NO_COLOR" in variable or "\x1b" not in seen.raw, seen.raw
    assert (
        "\x1b[31m"
        in on_a_terminal(["resolve", "nothing"], folder, environment={"NO_COLOR": ""}).raw
    )
