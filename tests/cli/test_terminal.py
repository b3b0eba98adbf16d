"""`uoarm request` on a real terminal: its messages are seen, and the last table is not empty."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.cli.terminal import on_a_terminal

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


def test_of_a_flood_some_are_shown_and_the_others_counted(folder: Path) -> None:
    seen = on_a_terminal(["request", "flood"], folder)
    assert seen.code == 0, seen.text
    shown = len(messages(seen.text))
    assert 0 < shown < 20_000
    received = int(seen.last.split(" messages")[0].split()[-1].replace(",", ""))
    assert f"{received - shown:,} of them not shown" in seen.last


def test_a_long_message_takes_one_line_and_is_no_markup(folder: Path) -> None:
    seen = on_a_terminal(["request", "long"], folder, width=80)
    [line] = [line for line in seen.text.splitlines() if "[red]xxx" in line]
    assert len(line) <= 80
    assert line.endswith("…")
