"""The counts and clocks of a line, without one; a line of another make, with the whole bridge."""

from __future__ import annotations

import json
import socket
import threading
from pathlib import Path
from typing import Any

import pytest
import uoarm_rocos
from attrs import asdict
from hypothesis import given
from hypothesis import strategies as st
from lines import LIMIT, listening
from rigs import endpoint
from tests.processes import run_python  # type: ignore[import-not-found]
from uoarm_rocos import DeviceOptions, LengthFramer, LineParts, TcpTransport, WireError, bridge_type
from uoarm_rocos._catalogue import (
    CallMessage,
    CatalogueMessage,
    DescribeMessage,
    ResultMessage,
    WireMessage,
)
from uoarm_rocos._health import ConversationIds, HeartbeatWatch, SequenceCheck
from uoarm_rocos.simulate import robot_catalogue

from uoarm.bridge import Registry, options_table
from uoarm.config import inspect
from uoarm.model import BridgeSpec


@given(st.integers(0, 2**32 - 1), st.lists(st.integers(0, 5), max_size=20))
def test_lost_messages_are_counted_across_the_largest_number(first: int, gaps: list[int]) -> None:
    incoming, seq = SequenceCheck(), first
    incoming.take(seq)
    expected = 0
    for gap in gaps:
        seq = (seq + 1 + gap) % 2**32
        begun_anew = incoming.take(seq)
        if begun_anew:  # a gap that ends at 0 is the same as a device that restarted
            assert seq == 0
            assert gap > 0
        else:
            expected += gap
    assert incoming.lost == expected


def test_a_sequence_that_begins_anew_is_noticed() -> None:
    incoming = SequenceCheck()
    assert [incoming.take(seq) for seq in (0, 1, 2, 0, 1)] == [False, False, False, True, False]


def test_ids_go_round_without_zero() -> None:
    ids = ConversationIds()
    assert [ids.next() for _ in range(3)] == [1, 2, 3]
    ids._count = iter([2**32 - 2, 2**32 - 1])  # type: ignore[assignment]  # far ahead
    assert [ids.next(), ids.next()] == [2**32 - 1, 1]


def test_the_watch_speaks_after_a_period_and_gives_up_after_three_and_a_half() -> None:
    watch = HeartbeatWatch(2.0, sent=10.0, received_at=10.0)
    assert [watch.is_heartbeat_due(now) for now in (11.9, 12.0)] == [False, True]
    assert [watch.dead(now) for now in (17.0, 17.5)] == [0.0, 7.5]


class JsonCodec:
    """Another codec, as a holder of a vendor's documents might write one."""

    def write(self, message: WireMessage) -> bytes:
        fields = asdict(message, recurse=False)
        return json.dumps([type(message).__name__, fields]).encode()

    def read(self, data: bytes) -> WireMessage:
        kind, fields = json.loads(data)
        if kind == "CatalogueMessage":
            return CatalogueMessage(catalogue=robot_catalogue(), **fields)
        if kind == "ResultMessage":
            return ResultMessage(**fields)
        raise WireError(f"unexpected {kind}")


def serve_json(listener: socket.socket) -> None:
    """A device that speaks JSON: gives its catalogue, then echoes calls."""
    connection = listener.accept()[0]
    framer, seq = LengthFramer(), 0
    with connection:
        while data := connection.recv(10_000):
            for part in framer.feed(data):
                kind, fields = json.loads(part)
                answer: list[Any]
                if kind == DescribeMessage.__name__:
                    answer = ["CatalogueMessage", {"seq": seq, "id": fields["id"]}]
                elif kind == CallMessage.__name__:
                    values = fields["values"]
                    answer = ["ResultMessage", {"seq": seq, "id": fields["id"], "values": values}]
                else:
                    continue
                seq += 1
                connection.sendall(framer.frame(json.dumps(answer).encode()))


def test_codec_framer_and_transport_may_be_others() -> None:
    with listening() as (listener, port):
        thread = threading.Thread(target=serve_json, args=(listener,))
        thread.start()

        def wire(options: object) -> LineParts:
            del options
            return LineParts(lambda: TcpTransport("127.0.0.1", port), LengthFramer, JsonCodec())

        registry = Registry([])
        registry.add(bridge_type("vendor", "a vendor's devices", wire))
        options = {"devices": {"robot": {"url": "tcp://vendor:1"}}}
        bridge = registry.create(BridgeSpec("rocos", "vendor", options))
        echo = endpoint("robot", "echo", "service")
        assert bridge.call(echo, {"text": "through JSON"}) == {"text": "through JSON"}
        bridge.close()
        thread.join(LIMIT)
        assert not thread.is_alive()


def test_every_public_name_is_there_and_loading_the_plugin_is_light() -> None:
    for name in uoarm_rocos.__all__:
        assert getattr(uoarm_rocos, name) is not None
    with pytest.raises(AttributeError, match="nothing_such"):
        _ = uoarm_rocos.nothing_such
    code = "import sys, uoarm_rocos; print({'serial', 'defusedxml', 'click'} & set(sys.modules))"
    done = run_python("-c", code, check=True)
    assert "serial" not in done.stdout
    assert "defusedxml" not in done.stdout


def test_the_doctor_says_what_there_is() -> None:
    (kind,) = uoarm_rocos.uoarm_bridge_types()
    assert kind.doctor
    found = kind.doctor()
    assert found.keys() == {"pyserial", "serial ports", "eSpeak NG", "Festival", "aplay"}
    assert all(found.values())


def test_the_table_of_options_is_what_the_plugin_declares() -> None:
    page = Path(__file__).parents[3] / "docs" / "rocos.md"
    table = options_table(DeviceOptions.schema(), "option of a device")
    assert table in page.read_text(encoding="utf-8")


def test_a_wrong_option_is_reported_with_its_place_and_the_one_that_is_meant(
    tmp_path: Path,
) -> None:
    file = tmp_path / "robot.yaml"
    file.write_text(
        "version: 1\n"
        "bridges:\n"
        "  rocos: {plugin: rocos, options: {devices: {clip: {url: /dev/clip, driwer: nonin-1}}}}\n"
        "functions:\n"
        "  pulse:\n"
        "    components:\n"
        "      - {name: c, bridge: rocos, output: {endpoint: [clip, pulse], options: {qos: 1}}}\n"
    )
    problems = inspect(file, types=Registry().types).problems
    assert [problem.hint for problem in problems] == ['did you mean "driver"?', "known keys: none"]
    for problem, (line, word) in zip(problems, ((3, "driwer"), (7, "qos")), strict=True):
        assert f"robot.yaml:{line}:" in str(problem)
        assert f'unknown key "{word}"' in str(problem)
