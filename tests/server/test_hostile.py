"""Each hostile input has one plain error for an answer, and the session goes on."""

from __future__ import annotations

import pytest
from tests.server.conftest import Serve
from tests.server.hostile import HOSTILE, Hostile
from tests.server.talk import Talk

from uoarm.server import Limits

UNPACED = Limits(elements_per_second=1e9)
"""At what pace values are read, test_intake.py has."""


@pytest.mark.parametrize("hostile", HOSTILE.values(), ids=HOSTILE.keys())
def test_it_is_refused_and_the_session_goes_on(serve: Serve, hostile: Hostile) -> None:
    server = serve(UNPACED)
    url = f"ws://127.0.0.1:{server.ports[0]}/uoarm"
    with Talk(url, binary=hostile.form == "cbor") as client:
        for frame in hostile.frames():
            client.raw(frame)
        client.ask("List")
        errors = [client.answer(identity) for identity in client.unanswered]
    assert [error["op"] for error in errors] == ["Error"] * hostile.errors
    for error in errors:
        assert error["jsonMessage"]["code"] in {"unreadable", "limit", "unknown"}
        assert len(error["jsonMessage"]["text"]) < 400
