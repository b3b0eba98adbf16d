"""What a robot has after another start: functions of the same names that mean other things."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import TypedDict


class Text(TypedDict):
    text: str


def texts() -> Iterator[Text]:
    while True:
        yield {"text": "x"}
        time.sleep(0.005)


def twice(value: Text) -> Text:
    return {"text": 2 * value["text"]}


def drive(command: Text) -> None:
    del command
