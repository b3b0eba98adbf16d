"""Each hostile input has one plain error for an answer, and the session goes on."""

from __future__ import annotations

import json

import pytest
from tests.server.hostile import HOSTILE, Hostile
from tests.server.ros import Ros
from tests.server.ros import url as ros_url
from tests.server.talk import Talk

from uoarm.server import Server


@pytest.mark.parametrize("hostile", HOSTILE.values(), ids=HOSTILE.keys())
def test_it_is_refused_and_the_session_goes_on(server: Server, hostile: Hostile) -> None:
    if hostile.form == "rosbridge":
        _refused_by_rosbridge(server, hostile)
    else:
        _refused(server, hostile)


def _refused(server: Server, hostile: Hostile) -> None:
    url = f"ws://127.0.0.1:{server.ports[0]}{hostile.path}"
    with Talk(url, binary=hostile.form == "cbor") as client:
        for frame in hostile.frames():
            client.raw(frame)
        client.ask("List")
        errors = [client.answer(identity) for identity in client.unheard]
    assert [one["op"] for one in errors] == ["Error"] * hostile.errors
    for one in errors:
        assert one["jsonMessage"]["code"] in {"unreadable", "limit", "unknown"}
        assert len(one["jsonMessage"]["text"]) < 400


def _refused_by_rosbridge(server: Server, hostile: Hostile) -> None:
    with Ros(ros_url(server)) as client:
        for frame in hostile.frames():
            client.socket.send(frame)
        client.send(op="call_service", service="/rosapi/get_time", id="last")
        told = [client.receive() for _ in range(hostile.errors + 1)]
    assert [one["op"] for one in told] == ["status"] * hostile.errors + ["service_response"]
    assert told[-1]["result"] is True
    assert all(len(json.dumps(one)) < 600 for one in told)
