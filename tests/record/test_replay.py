"""A recording is a component: what was recorded comes out again, in order, and proven."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from mcap.writer import CompressionType, IndexType, Writer
from tests.no_threads import no_threads
from tests.record.conftest import COUNT, PICTURE

from uoarm import RobotManager
from uoarm.bridge import message_check
from uoarm.config import loads
from uoarm.errors import BridgeError, MessageError, ResolutionError
from uoarm.model import Endpoint, Health, MessageStructure, QueuePolicy, Role, StatusEvent
from uoarm.record import _bridge, _reading
from uoarm.record._bridge import RecordingBridge
from uoarm.record._checking import open_recording
from uoarm.record._reading import McapReader
from uoarm.record._records import MAGIC
from uoarm.record.plugin import PlaybackOptions
from uoarm.testing import Background, Collector, MemoryBridge, patience, wait

BLOCK = QueuePolicy(length=1000, policy="block", timeout=600)
REPLAY = """
version: 1
bridges:
  memory: {plugin: memory}
  tape: {plugin: recording, options: {file: FILE, rate: fast}}
functions:
  counter:
    components:
      - {name: clicks, bridge: memory, priority: 2, output: {endpoint: [clicks]}}
      - {name: of_then, bridge: tape, priority: 1, output: {endpoint: [/counter]}}
  doubled:
    components:
      - {name: doubler, bridge: memory, input: {from: counter, endpoint: [doubler]},
         output: {endpoint: [doubler]}}
  base:
    components:
      - name: motor
        bridge: memory
        input: {from: counter, endpoint: [motor], lifetime: 1, meaning: stated,
                stop: {message: {n: 0}}}
"""
MESSAGES = [{"n": n} for n in range(300)]


def record(make_robot: Callable[[], RobotManager], bridge: MemoryBridge, path: Path) -> Path:
    clicks, eye = bridge.emitter("clicks", COUNT), bridge.emitter("eye", PICTURE)
    robot = make_robot()
    with robot.record("counter", "camera", path=path, queue=BLOCK):
        for message in MESSAGES:
            clicks.emit(message)
        eye.emit({"width": 3, "name": "eye", "data": b"abc"})
    bridge.die("clicks")
    bridge.die("eye")
    return path


@pytest.fixture
def tape(make_robot: Any, bridge: MemoryBridge, tmp_path: Path) -> Path:
    return record(make_robot, bridge, tmp_path / "run.mcap")


def played(path: Path, topic: str, count: int, **options: object) -> list[Any]:
    made = RecordingBridge(
        "tape", PlaybackOptions.of({"file": str(path), "rate": "fast", **options})
    )
    try:
        collector = Collector()
        endpoint = Endpoint("tape", "run", Role.OUTPUT, (topic,))
        structure = made.describe(endpoint).message
        assert structure is not None
        source = made.open_source(endpoint, structure, collector.deliver)
        messages = collector.wait(count, patience())
        source.close()
        return list(messages)
    finally:
        made.close()


@pytest.mark.parametrize(
    ("rate", "sentence"),
    [
        (0, "expected more than 0 or fast, got 0"),
        (1e308, "expected at most 1000000000 or fast, got 1e+308"),
        ("slow", 'expected a number or fast, got "slow"'),
    ],
)
def test_a_rate_that_is_none_says_what_one_is(tape: Path, rate: object, sentence: str) -> None:
    options = json.dumps({"file": str(tape), "rate": rate})
    robot = RobotManager(
        loads(
            f"version: 1\nbridges: {{tape: {{plugin: recording, options: {options}}}}}\n"
            "functions: {c: {components: [{name: c, bridge: tape, output: {endpoint: [/x]}}]}}\n"
        )
    )
    with robot, pytest.raises(ResolutionError) as caught:
        robot.request("c")
    assert sentence in str(caught.value)


def counted_file(path: Path, *numbers: int) -> Path:
    """A file whose first message is of /c; there is nothing in /none."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("Count", "jsonschema", json.dumps(COUNT).encode())
        filled, _ = (writer.register_channel(topic, "json", schema) for topic in ("/c", "/none"))
        for place, n in enumerate(numbers):
            writer.add_message(filled, 1000 + place, json.dumps({"n": n}).encode(), 0)
        writer.finish()  # type: ignore[no-untyped-call]  # of mcap
    return path


def test_a_loop_over_an_empty_channel_does_not_turn_without_a_pause(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = counted_file(tmp_path / "x.mcap", 1, 1)
    monkeypatch.setattr(_bridge, "_EMPTY_SECONDS", patience())
    made = RecordingBridge(
        "tape", PlaybackOptions.of({"file": str(path), "rate": "fast", "loop": True})
    )
    laps: list[str] = []
    read = made._file.messages

    def counted(topic: str, since: int, on_damage: Callable[[str], object]) -> Any:
        laps.append(topic)
        return read(topic, since, on_damage)

    monkeypatch.setattr(made._file, "messages", counted)
    collector = Collector()
    sources = [
        made.open_source(
            Endpoint("tape", "run", Role.OUTPUT, (topic,)),
            MessageStructure(COUNT),
            collector.deliver,
        )
        for topic in ("/none", "/c")
    ]
    collector.wait(1000, patience())
    for source in sources:
        source.close()
    made.close()
    assert laps.count("/none") == 1
    assert laps.count("/c") >= 500


def test_what_was_recorded_comes_out_again(tape: Path) -> None:
    assert played(tape, "/counter", len(MESSAGES)) == MESSAGES
    (picture,) = played(tape, "/camera", 1)
    assert picture == {"width": 3, "name": "eye", "data": b"abc"}


def test_a_recording_may_have_any_name(tape: Path) -> None:
    assert played(tape.rename(tape.with_name("run")), "/counter", len(MESSAGES)) == MESSAGES


def test_it_says_that_it_is_recorded_and_what_it_has(tape: Path) -> None:
    made = RecordingBridge("tape", PlaybackOptions.of({"file": str(tape)}))
    (found,) = made.discover()
    assert found.name == "run"
    assert found.detail.startswith("recorded: run.mcap, from ")
    described = {endpoint.address[0]: description for endpoint, description in found.endpoints}
    assert set(described) == {"/counter", "/camera"}
    marked = MessageStructure({**COUNT, "x-recorded": True}, native_type="clicks/Row")
    assert described["/counter"].message == marked
    assert described["/counter"].note.startswith("recorded: run.mcap")
    assert made.facts()["recorded"] == "run.mcap"
    made.close()


def test_the_status_says_that_a_candidate_is_recorded(
    tape: Path, bridge: MemoryBridge, make_robot: Any
) -> None:
    bridge.emitter("clicks", COUNT)
    robot = make_robot(REPLAY.replace("FILE", json.dumps(str(tape))))
    counter = robot.check_availability()[0]
    assert counter.candidates[0].notes == ()
    assert "available; of_then.output.default: recorded: run.mcap, from " in str(counter)


def test_it_takes_over_when_the_sensor_dies(
    tape: Path, bridge: MemoryBridge, make_robot: Any
) -> None:
    clicks = bridge.emitter("clicks", COUNT)
    robot = make_robot(REPLAY.replace("FILE", json.dumps(str(tape))))
    events: list[StatusEvent] = []
    robot.listen(events.append)
    with robot.request("counter", queue=BLOCK) as connection:
        clicks.emit({"n": -1})
        assert connection.get(patience()) == {"n": -1}
        bridge.die("clicks")
        assert [connection.get(patience()) for _ in MESSAGES] == MESSAGES
        wait(lambda: connection.gaps, "the gap is noted")
        (gap,) = connection.gaps
        assert gap.after == ("of_then",)
        wait(lambda: any(event.change == "replaced" for event in events), "it is announced")
        assert any("recorded: run.mcap" in warning for warning in connection.plan.warnings)
    (event,) = [event for event in events if event.change == "replaced"]
    assert event.cause == f"{gap.cause}; of_then goes on with what was recorded"


def test_the_proof_says_what_drifted_since(
    tape: Path, bridge: MemoryBridge, make_robot: Any
) -> None:
    narrow = {**COUNT, "properties": {"n": {"type": "integer", "maximum": 255}}}
    doubler = bridge.loop("doubler", narrow)
    assert doubler is not None
    robot = make_robot(REPLAY.replace("FILE", json.dumps(str(tape))))
    with pytest.raises(ResolutionError, match="of_then"):
        robot.resolve("doubled")


def test_it_moves_nothing_unless_that_is_said(
    tape: Path, bridge: MemoryBridge, make_robot: Any
) -> None:
    bridge.taker("motor", COUNT)
    text = REPLAY.replace("FILE", json.dumps(str(tape)))
    with pytest.raises(ResolutionError, match="gives what was recorded, and motor moves something"):
        make_robot(text).resolve("base")
    allowed = make_robot(text.replace("rate: fast", "rate: fast, allow_motion: true"))
    assert allowed.resolve("base").provider.component.name == "motor"


def test_it_is_played_paused_stepped_and_sought_by_its_service(tape: Path) -> None:
    text = f"""
version: 1
bridges: {{tape: {{plugin: recording, options: {{file: {json.dumps(str(tape))}, paused: true}}}}}}
functions:
  counter: {{components: [{{name: then, bridge: tape, output: {{endpoint: [/counter]}}}}]}}
  tape: {{components: [{{name: control, bridge: tape, service: {{endpoint: ["@control"]}}}}]}}
"""
    with RobotManager(loads(text)) as robot, robot.request("counter", queue=BLOCK) as counter:
        status = robot.call("tape", {})
        assert status["is_paused"]
        for n in (0, 1):
            robot.call("tape", {"step": True})
            assert counter.get(patience()) == {"n": n}
        assert robot.call("tape", {"seek": 0})["position"] == 0
        robot.call("tape", {"step": True})
        assert counter.get(patience()) == {"n": 0}
        assert robot.call("tape", {"rate": "fast", "pause": False})["rate"] is None
        rest = [counter.get(patience()) for _ in MESSAGES[1:]]
        assert rest == MESSAGES[1:]
        wait(lambda: counter.ended, "the recording has been played")


@pytest.mark.parametrize("waits", [True, False])
def test_nothing_of_what_is_paused_comes_before_it_is_asked_for(
    tmp_path: Path, waits: bool
) -> None:
    """A step that is asked for at once, too, lets the first message pass, and nothing more."""
    path = counted_file(tmp_path / "x.mcap", 1, 2, 3)
    made = RecordingBridge("tape", PlaybackOptions.of({"file": str(path), "paused": True}))
    collector, endpoint = Collector(), Endpoint("tape", "x", Role.OUTPUT, ("/c",))
    structure = made.describe(endpoint).message
    assert structure is not None
    with closing(made), closing(made.open_source(endpoint, structure, collector.deliver)) as source:
        for count in (1, 2):
            if waits:
                wait(lambda: made.playback._next.get(source) is not None)
            assert len(collector.messages) == count - 1
            made.playback.step()
            collector.wait(count, patience())
            assert collector.messages == [{"n": 1}] * count
            made.playback.seek(0)


def test_it_loops_and_begins_where_it_is_asked_to(tape: Path) -> None:
    again = played(tape, "/counter", 2 * len(MESSAGES), loop=True)
    assert again[: 2 * len(MESSAGES)] == MESSAGES + MESSAGES
    with pytest.raises(BridgeError, match="`from` is 1e\\+06 s"):
        RecordingBridge("tape", PlaybackOptions.of({"file": str(tape), "from": 1e6}))


def test_a_slow_consumer_is_waited_for(tape: Path, bridge: MemoryBridge, make_robot: Any) -> None:
    robot = make_robot(REPLAY.replace("FILE", json.dumps(str(tape))))
    queue = QueuePolicy(length=1, policy="block", timeout=600)
    with robot.request("counter", queue=queue) as connection:
        assert [connection.get(patience()) for _ in MESSAGES] == MESSAGES


# Files of others, and broken ones.


def foreign_file(path: Path, **options: Any) -> Path:
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start("ros2")
        schema = writer.register_schema("lab/msg/Count", "ros2msg", b"int32 n\nuint8[] data\n")
        picture = writer.register_schema(
            "Picture",
            "jsonschema",
            json.dumps(
                {
                    "type": "object",
                    "properties": {"data": {"type": "string", "contentEncoding": "base64"}},
                }
            ).encode(),
        )
        proto = writer.register_schema("Proto", "protobuf", b"\0")
        counted = writer.register_channel("/count", "cdr", schema)
        pictures = writer.register_channel("/picture", "json", picture)
        protos = writer.register_channel("/proto", "protobuf", proto)
        loose = writer.register_channel("/loose", "json", 0)
        for n in range(100):
            octets = b"\0\1\0\0" + n.to_bytes(4, "little") + b"\2\0\0\0hi"
            writer.add_message(counted, 1000 + (99 - n if options.get("back") else n), octets, 0)
        writer.add_message(pictures, 1000, b'{"data": "aGk="}', 0)
        writer.add_message(protos, 1000, b"\1\2", 0)
        writer.add_message(loose, 1000, b"[1, 2]", 0)
        writer.finish()  # type: ignore[no-untyped-call]  # of mcap
    return path


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"compression": CompressionType.LZ4, "chunk_size": 200},
        {"compression": CompressionType.NONE, "chunk_size": 200},
        {"use_chunking": False},
        {"use_chunking": False, "use_statistics": False, "repeat_channels": False},
        {"index_types": IndexType.NONE, "chunk_size": 200},
        {"index_types": IndexType.NONE, "use_statistics": False, "chunk_size": 200},
        {"repeat_channels": False, "repeat_schemas": False},
        {"repeat_schemas": False, "chunk_size": 200},
    ],
    ids=str,
)
def test_files_of_others_are_read_however_they_are_written(tmp_path: Path, options: Any) -> None:
    path = foreign_file(tmp_path / "other.mcap", **options)
    assert played(path, "/count", 100) == [{"n": n, "data": b"hi"} for n in range(100)]
    assert played(path, "/picture", 1) == [{"data": b"hi"}]


def test_what_is_not_read_is_refused_by_name(tmp_path: Path) -> None:
    path = foreign_file(tmp_path / "other.mcap")
    made = RecordingBridge("tape", PlaybackOptions.of({"file": str(path)}))
    with pytest.raises(BridgeError, match=r"/proto has messages as 'protobuf'.*what is read is"):
        made.describe(Endpoint("tape", "x", Role.OUTPUT, ("/proto",)))
    assert made.describe(Endpoint("tape", "x", Role.OUTPUT, ("/loose",))).message is None
    with pytest.raises(BridgeError, match="no channel '/none'; it has /count"):
        made.describe(Endpoint("tape", "x", Role.OUTPUT, ("/none",)))
    with pytest.raises(BridgeError, match="a recording has no inputs"):
        made.open_sink(Endpoint("tape", "x", Role.INPUT, ("/count",)), MessageStructure(True))
    (found,) = made.discover()
    assert "/proto" in found.detail
    made.close()


def test_every_publisher_of_a_topic_is_read(tmp_path: Path) -> None:
    path = tmp_path / "made-of-a-bag.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros1")
        schema = writer.register_schema("std_msgs/Int32", "ros1msg", b"int32 data\n")
        other = writer.register_schema("std_msgs/Int8", "ros1msg", b"int8 data\n")
        left, right = (
            writer.register_channel("/n", "ros1", schema, {"callerid": name}) for name in ("l", "r")
        )
        stray = writer.register_channel("/n", "ros1", other, {"callerid": "l"})
        for n in range(6):
            writer.add_message((left, right)[n % 2], n, n.to_bytes(4, "little"), n)
        writer.add_message(stray, 9, b"\1", 9)
        writer.finish()  # type: ignore[no-untyped-call]  # of mcap
    assert played(path, "/n", 6) == [{"data": n} for n in range(6)]
    assert McapReader(path).notes == ["/n has another channel of another kind, which is not read"]


@pytest.mark.parametrize(
    "schema", ['{"type": "frob"}', '{"properties": {"a": {"minimum": "b"}}}', "[]", "{"]
)
def test_a_schema_that_is_none_is_refused_and_not_met_by_a_message(
    tmp_path: Path, schema: str
) -> None:
    path = tmp_path / "odd.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(
            "/a", "json", writer.register_schema("Odd", "jsonschema", schema.encode())
        )
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()  # type: ignore[no-untyped-call]  # of mcap
    made = RecordingBridge("tape", PlaybackOptions.of({"file": str(path)}))
    with pytest.raises(BridgeError, match="channel /a: its schema 'Odd': "):
        made.describe(Endpoint("tape", "x", Role.OUTPUT, ("/a",)))
    made.close()


def described_from(path: Path, schema: object) -> MessageStructure | None:
    """Return how a channel with a JSON Schema is described."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        text = json.dumps(schema).encode()
        channel = writer.register_channel(
            "/a", "json", writer.register_schema("Old", "jsonschema", text)
        )
        writer.add_message(channel, 1, b"{}", 1)
        writer.finish()  # type: ignore[no-untyped-call]  # of mcap
    made = RecordingBridge("tape", PlaybackOptions.of({"file": str(path)}))
    found = made.describe(Endpoint("tape", "x", Role.OUTPUT, ("/a",))).message
    made.close()
    return found


def test_a_schema_of_an_older_draft_is_read_as_one(tmp_path: Path) -> None:
    draft = "http://json-schema.org/draft-07/schema#"
    items = {"items": [{"type": "integer"}], "additionalItems": {"$ref": "#/definitions/t"}}
    schema = {"properties": {"a": items}, "definitions": {"t": {"type": "string"}}}
    found = described_from(tmp_path / "old.mcap", {"$schema": draft, **schema})
    assert found is not None
    check = message_check(found, "old")
    check({"a": [1, "b"]})
    with pytest.raises(MessageError, match=r"a\.1: expected text"):
        check({"a": [1, 2]})


def test_of_a_schema_whose_draft_is_not_known_the_configuration_may_say_what_it_is(
    tmp_path: Path,
) -> None:
    assert described_from(tmp_path / "odd.mcap", {"$schema": "http://elsewhere/meta"}) is None


@pytest.mark.parametrize("cut", [1, 30, 300, 1000])
def test_the_readable_part_of_a_cut_file_is_read_and_the_rest_named(
    tmp_path: Path, cut: int
) -> None:
    path = foreign_file(tmp_path / "cut.mcap", chunk_size=200, compression=CompressionType.NONE)
    octets = path.read_bytes()
    path.write_bytes(octets[:-cut])
    reader = McapReader(path)
    messages = list(reader.messages("/count", 0, pytest.fail))
    assert 0 < len(messages) <= 100
    assert [message.time for message in messages] == list(range(1000, 1000 + len(messages)))
    if cut > 30:
        assert reader.notes or len(messages) == 100


def everything(path: Path) -> tuple[Any, list[str]]:
    """Return what is read of a file, and what it says of what is not."""
    damages: list[str] = []
    try:
        reader = McapReader(path)
    except BridgeError as error:
        return None, [str(error)]
    messages = {
        topic: [
            (message.time, bytes(message.data))
            for message in reader.messages(topic, 0, damages.append)
        ]
        for topic in reader.channels
    }
    kinds = {topic: channel.kind for topic, channel in reader.channels.items()}
    return (reader.start, reader.end, kinds, messages), reader.notes + damages


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD])
def test_a_file_of_which_an_octet_has_changed_is_read_as_it_was_or_says_so(
    tmp_path: Path, compression: CompressionType
) -> None:
    path = foreign_file(tmp_path / "file.mcap", chunk_size=800, compression=compression)
    octets, (right, _) = path.read_bytes(), everything(path)
    for place in range(0, len(octets), 37):
        path.write_bytes(octets[:place] + bytes([octets[place] ^ 0x10]) + octets[place + 1 :])
        found, notes = everything(path)
        assert found == right or notes, place


def test_what_stands_behind_the_end_of_a_file_is_named(tmp_path: Path) -> None:
    path = foreign_file(tmp_path / "file.mcap", chunk_size=800)
    octets, (right, _) = path.read_bytes(), everything(path)
    path.write_bytes(octets + octets)
    assert everything(path) == (right, [f"{len(octets):,} octets behind its end are not read"])


def test_a_chunk_without_messages_has_no_time(tmp_path: Path) -> None:
    from mcap import records
    from mcap.data_stream import RecordBuilder

    def written(*parts: records.McapRecord) -> bytes:
        builder = RecordBuilder()
        for part in parts:
            part.write(builder)
        return bytes(builder.end())  # type: ignore[no-untyped-call]  # of mcap

    channel = records.Channel(1, "/a", "json", {}, 0)
    message = records.Message(1, 5, b"1", 5, 0)
    octets, indexes = MAGIC + written(records.Header("", "")), []
    for parts, time in (((channel,), 0), ((message,), 5)):
        data = written(*parts)
        chunk = written(records.Chunk("", data, time, time, 0, len(data)))
        sizes = {"compressed_size": len(data), "uncompressed_size": len(data)}
        indexes.append(
            records.ChunkIndex(
                len(octets),
                len(chunk),
                "",
                message_end_time=time,
                message_index_length=0,
                message_index_offsets={},
                message_start_time=time,
                **sizes,
            )
        )
        octets += chunk
    octets += written(records.DataEnd(0))
    summary = written(channel, *indexes)
    path = tmp_path / "file.mcap"
    path.write_bytes(octets + summary + written(records.Footer(len(octets), 0, 0)) + MAGIC)
    reader = McapReader(path)
    assert (reader.start, reader.end, reader.notes) == (5, 5, [])
    assert [message.time for message in reader.messages("/a", 0, pytest.fail)] == [5]


def test_a_file_that_is_none_says_so(tmp_path: Path) -> None:
    (tmp_path / "text.mcap").write_text("hello")
    with pytest.raises(BridgeError, match="is no MCAP file"):
        McapReader(tmp_path / "text.mcap")
    with pytest.raises(BridgeError, match="cannot be read: No such file"):
        McapReader(tmp_path / "none.mcap")


def test_no_length_in_a_file_is_believed(tmp_path: Path) -> None:
    path = foreign_file(tmp_path / "bad.mcap", chunk_size=1000)
    octets = path.read_bytes()
    for place in range(8, len(octets) - 8, 29):
        broken = bytearray(octets)
        broken[place : place + 8] = b"\xff" * 8
        path.write_bytes(broken)
        damages: list[str] = []
        try:
            reader = McapReader(path)
            for topic in reader.channels:
                for _ in reader.messages(topic, 0, damages.append):
                    pass
        except BridgeError:
            continue


def test_a_bag_whose_types_changed_is_read_by_the_first_definition(tmp_path: Path) -> None:
    rosbags = pytest.importorskip("rosbags.rosbag1")
    path = tmp_path / "changed.bag"
    with rosbags.Writer(path) as writer:
        for number, text in enumerate(("int32 a", "float32 a", "int32 a # of another publisher")):
            md5 = hashlib.md5(text[: text.index(" a") + 2].encode()).hexdigest()
            connection = writer.add_connection(
                "/thing",
                "own_msgs/msg/Thing",
                msgdef=f"{text}\n",
                md5sum=md5,
                callerid=f"/{number}",
            )
            for n in range(2):
                writer.write(connection, 1000 * number + n, bytes([number, 0, 0, n]))
    recording = open_recording(path)
    assert recording.notes == ["/thing has messages of two types or definitions: the first is read"]
    read = recording.messages("/thing", 0, pytest.fail)
    assert [message.time for message in read] == [0, 1, 2000, 2001]


def test_a_bag_without_definitions_says_what_adds_them(tmp_path: Path) -> None:
    rosbags = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    bag = tmp_path / "bag"
    with rosbags.Writer(bag, version=9) as writer:
        writer.add_connection("/text", "std_msgs/msg/String", typestore=store)
    with sqlite3.connect(bag / "bag.db3") as database:
        database.execute("DELETE FROM message_definitions")
    with pytest.raises(BridgeError, match="wrote no definitions, as before Iron: `ros2 bag conv"):
        open_recording(bag)


def test_a_bag_of_ros_1_is_read(tmp_path: Path) -> None:
    rosbags = pytest.importorskip("rosbags.rosbag1")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
    path = tmp_path / "old.bag"
    with rosbags.Writer(path) as writer:
        connection = writer.add_connection("/text", "std_msgs/msg/String", typestore=store)
        kind = store.types["std_msgs/msg/String"]
        for n in range(10):
            text = store.serialize_ros1(kind(data=f"text {n}"), "std_msgs/msg/String")
            writer.write(connection, 1000 + n, text)
    assert played(path, "/text", 10) == [{"data": f"text {n}"} for n in range(10)]
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(BridgeError, match="`rosbag reindex` makes the index"):
        open_recording(path)


@pytest.mark.parametrize(
    ("name", "lacks", "advice"),
    [
        ("MCAP", "", "; give {bag}/bag.mcap as the file"),
        ("SQLITE3", "metadata.yaml", "; `ros2 bag reindex {bag}` mends"),
    ],
)
def test_a_bag_of_ros_2_whose_recorder_was_killed_says_what_helps(
    tmp_path: Path, name: str, lacks: str, advice: str
) -> None:
    bag = tmp_path / "bag"
    write_texts(bag, [1000], name)
    open_recording(bag)
    if lacks:
        (bag / lacks).unlink()
    else:
        file = bag / "bag.mcap"
        file.write_bytes(file.read_bytes()[:-100])
        assert played(file, "/text", 1) == [{"data": "1000"}]
    with pytest.raises(BridgeError, match=re.escape(advice.format(bag=bag))):
        open_recording(bag)


@pytest.mark.parametrize("plugin", ["SQLITE3", "MCAP"])
@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("nanoseconds_since_epoch", 10**30),
        ("nanoseconds_since_epoch", -5),
        ("nanoseconds_since_epoch", 2003),  # of the last file, as some recorders wrote it
        ("nanoseconds", 2),  # how long one file is
        ("message_count", 0),
    ],
)
def test_what_a_folder_says_of_its_times_is_not_believed(
    tmp_path: Path, plugin: str, key: str, said: int
) -> None:
    """Nor is the order in which it names its files."""
    bag, ending = tmp_path / "part_0", {"SQLITE3": ".db3", "MCAP": ".mcap"}[plugin]
    for part in (0, 1):
        write_texts(tmp_path / f"part_{part}", [2000 + 3 * part + n for n in range(3)], plugin)
    shutil.copy(tmp_path / "part_1" / f"part_1{ending}", bag)
    metadata = bag / "metadata.yaml"
    text = metadata.read_text()
    names = f"  - part_1{ending}\n  - part_0{ending}\n"
    text = re.sub(rf"( +)- part_0{ending}\n", names.replace("  -", r"\1-"), text, count=1)
    assert text.count(f"part_1{ending}") == 1
    metadata.write_text(re.sub(rf"({key}: )\d+", rf"\g<1>{said}", text))
    recording = open_recording(bag)
    assert (recording.start, recording.end) == (2000, 2005)
    read = recording.messages("/text", recording.start, pytest.fail)
    assert [message.time for message in read] == [*range(2000, 2006)]


def test_a_bag_with_times_that_are_none_is_refused(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    write_texts(bag, [1000], "SQLITE3")
    with sqlite3.connect(bag / "bag.db3") as database:
        database.execute("UPDATE messages SET timestamp = -5")
    with pytest.raises(BridgeError, match=r"expected times in nanoseconds .*, got -5 to -5"):
        open_recording(bag)


def write_texts(bag: Path, times: list[int], plugin: str) -> None:
    rosbags = pytest.importorskip("rosbags.rosbag2")
    typesys = pytest.importorskip("rosbags.typesys")
    store = typesys.get_typestore(typesys.Stores.ROS2_JAZZY)
    with rosbags.Writer(bag, version=9, storage_plugin=rosbags.StoragePlugin[plugin]) as writer:
        connection = writer.add_connection("/text", "std_msgs/msg/String", typestore=store)
        for time in times:
            text = store.types["std_msgs/msg/String"](data=str(time))
            writer.write(connection, time, store.serialize_cdr(text, "std_msgs/msg/String"))


def test_a_channel_that_a_cut_file_lost_names_the_cut(tmp_path: Path) -> None:
    path = tmp_path / "cut.mcap"
    path.write_bytes(MAGIC + b"\x06\xff")
    with pytest.raises(BridgeError, match=r"it has none; it ends within a record"):
        played(path, "/text", 1)


def test_what_fails_in_playing_is_a_loss(tape: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = RecordingBridge("tape", PlaybackOptions.of({"file": str(tape)}))
    reported: list[tuple[Health, str]] = []
    monkeypatch.setattr(made, "report", lambda *given, **_: reported.append(given))
    monkeypatch.setattr(made.playback, "begin", partial(divmod, 1, 0))
    endpoint = Endpoint("tape", "run", Role.OUTPUT, ("/counter",))
    with closing(made), closing(made.open_source(endpoint, MessageStructure(COUNT), pytest.fail)):
        wait(lambda: bool(reported), "the loss is reported")
    assert reported == [
        (Health.LOST, f"{tape}: ZeroDivisionError: integer division or modulo by zero")
    ]


def test_steps_wait_for_no_channel_for_which_there_was_no_thread(tape: Path) -> None:
    made = RecordingBridge("tape", PlaybackOptions.of({"file": str(tape), "paused": True}))
    endpoint, structure = (
        Endpoint("tape", "run", Role.OUTPUT, ("/counter",)),
        MessageStructure(COUNT),
    )
    with closing(made):
        with no_threads("tape-recording"), pytest.raises(BridgeError, match="new thread"):
            made.open_source(endpoint, structure, pytest.fail)
        assert not made.playback._readers
        came = Collector()
        with closing(made.open_source(endpoint, structure, came)):
            made.playback.step()
            wait(lambda: len(came.messages) == 1)


def test_a_part_for_which_there_is_no_thread_is_read_by_who_wants_it() -> None:
    found: Any = ({}, ())
    part: Any = SimpleNamespace(at=0, octets=1)
    cache = _reading._PartCache(lambda *_, **__: found)
    with no_threads():
        cache.prepare(part)
    assert Background(lambda: cache.get(part)).result() == found
