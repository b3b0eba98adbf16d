"""The status map as text: tables, and where they are too wide the same row by row."""

from __future__ import annotations

import pytest

from uoarm.model import format_status

STATUS = {
    "connections": [
        {"id": "c1", "function": "faceRecognition", "state": "running", "lost": 0, "cause": ""},
        {"id": "c2", "function": "x", "state": "failed", "lost": 1, "cause": "its bridge " * 9},
    ],
    "routes": [
        {
            "producer": "head_camera_driver.default",
            "consumer": "face_recognition_engine.default",
            "received": 720,
            "delivered": 365,
            "rate": 98.0,
            "dropped": [("queue-full", 354)],
        }
    ],
}


def test_a_table_has_its_columns_one_below_the_other() -> None:
    _, _, *lines = format_status({"routes": STATUS["routes"]}).splitlines()[2:]
    heads, row = lines
    assert heads.index("received") == row.index("720")
    assert heads.index("dropped") == row.index("queue-full 354")


@pytest.mark.parametrize("width", [40, 60])
def test_where_a_table_is_too_wide_each_row_says_what_it_has(width: int) -> None:
    text = format_status(STATUS, width)
    assert max(map(len, text.splitlines())) <= width
    joined = " ".join(text.split())
    assert "c1 function faceRecognition, state running, lost 0 c2" in joined
    assert f"c2 function x, state failed, lost 1, cause {'its bridge ' * 9}routes: 1" in joined
    if width > 40:
        assert (
            "head_camera_driver.default consumer face_recognition_engine.default, received 720, "
            "delivered 365, rate 98.0, dropped queue-full 354" in joined
        )


def test_a_table_that_fits_stays_one() -> None:
    few = {"connections": STATUS["connections"][:1]}
    assert format_status(few, 60) == format_status(few)


def test_a_fact_that_is_not_known_yet_is_left_out() -> None:
    facts = [("url", "ws://robot"), ("manager", ""), ("breaks", 0), ("clock_ahead", None)]
    text = format_status({"bridges": [{"name": "up", "facts": facts}]})
    assert "url ws://robot, breaks 0" in text
    assert not {"manager", "clock_ahead"} & set(text.split())
