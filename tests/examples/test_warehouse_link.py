"""The floor's process and its clients: an answer that came too late is dropped."""

from __future__ import annotations

import json
import socket
import sys
import threading
from pathlib import Path

import pytest

from uoarm.testing import patience

sys.path.insert(0, str(Path(__file__).parents[2] / "examples" / "warehouse"))

from warehouse_floor.link import FloorLink


def test_an_answer_to_an_earlier_question_is_passed_over() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as floor:
        floor.bind(("127.0.0.1", 0))
        floor.settimeout(patience())

        def answer() -> None:
            octets, sender = floor.recvfrom(65_507)
            number = json.loads(octets)["number"]
            for item in (number - 1, number):
                floor.sendto(json.dumps({"number": item, "to": item}).encode(), sender)

        thread = threading.Thread(target=answer)
        thread.start()
        with FloorLink(floor.getsockname()[1], patience()) as link:
            assert link.ask() == {"to": 1}
        thread.join(patience())


def test_a_refusal_says_why() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as floor:
        floor.bind(("127.0.0.1", 0))
        floor.settimeout(patience())

        def answer() -> None:
            _, sender = floor.recvfrom(65_507)
            floor.sendto(b'{"number": 1, "error": "no such vehicle"}', sender)

        thread = threading.Thread(target=answer)
        thread.start()
        with (
            FloorLink(floor.getsockname()[1], patience()) as link,
            pytest.raises(ValueError, match="no such vehicle"),
        ):
            link.ask(vehicle="none")
        thread.join(patience())
