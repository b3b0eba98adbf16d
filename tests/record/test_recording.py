"""What is recorded is what came: each message once and in order, whatever happens to the file."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import attrs
import pytest
from mcap.reader import make_reader
from tests.disk import full_after
from tests.no_threads import no_threads
from tests.record.conftest import COUNT, OCTETS, PICTURE, ROBOT, messages, of_topic, readable
from tests.structures import closed

from uoarm import Connection, RobotManager, record
from uoarm._control.engine.actions import Announce
from uoarm._control.live import connection_runtime
from uoarm._control.live.driver import Driver
from uoarm.cdr import Codec
from uoarm.cli._record import summary
from uoarm.errors import ConnectionClosedError, ResolutionError, UsageError
from uoarm.model import Message, MessageStructure, QueuePolicy, Robot, StatusEvent
from uoarm.record import Recording, RecordOptions, _recording
from uoarm.record._file import KeptMessage, Ring, documents
from uoarm.record._forms import EVENTS
from uoarm.record._options import Instant
from uoarm.testing import Background, Hang, MemoryBridge, patience, wait

MakeRobot = Callable[[], RobotManager]
BLOCK = QueuePolicy(length=1000, policy="block", timeout=600)


def read_json_of(path: str | Path, topic: str) -> list[Any]:
    return [json.loads(message.data) for message in of_topic(path, topic)]


def test_each_message_is_there_once_and_in_order(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    clicks, eye = bridge.emitter("clicks", COUNT), bridge.emitter("eye", PICTURE)
    robot = make_robot()
    with robot.record("counter", "camera", path=tmp_path / "run.mcap", queue=BLOCK) as recording:
        for n in range(500):
            clicks.emit({"n": n})
            eye.emit({"width": n, "name": "eye", "data": bytes([n % 256]) * 100})
    status = recording.status()
    assert (status.state, status.dropped) == ("ended", {})
    assert [channel.recorded for channel in status.channels] == [500, 500]
    (path,) = status.files
    assert Path(path).stat().st_size == status.octets
    assert read_json_of(path, "/counter") == [{"n": n} for n in range(500)]
    pictures = of_topic(path, "/camera")
    assert {picture.encoding for picture in pictures} == {"cdr"}
    assert pictures[0].schema.encoding == "ros2msg"
    read = Codec(MessageStructure(PICTURE)).decode
    assert [read(picture.data) for picture in pictures] == [
        {"width": n, "name": "eye", "data": bytes([n % 256]) * 100} for n in range(500)
    ]
    times = [message.log_time for message in messages(path)]
    assert times == sorted(times)


def test_one_that_opened_as_the_manager_closes_is_closed_as_well(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where the server ends that records what its configuration says."""
    made: list[Recording] = []
    is_open, is_closed = threading.Event(), threading.Event()

    class Late(Recording):
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            super().__init__(*args, **kwargs)
            made.append(self)
            is_open.set()
            assert is_closed.wait(patience())

    bridge.emitter("clicks", COUNT)
    robot = make_robot()
    monkeypatch.setattr(record, "Recording", Late)
    path = tmp_path / "run.mcap"
    with ThreadPoolExecutor(1) as pool:
        opening = pool.submit(partial(robot.record, "counter", path=path))
        assert is_open.wait(patience())
        robot.close()
        is_closed.set()
        with pytest.raises(ConnectionClosedError):
            opening.result(patience())
    assert made[0].ended
    assert of_topic(path, "/counter") == []


def test_the_file_says_what_it_rests_on_and_no_secrets(
    bridge: MemoryBridge, make_robot: Any, tmp_path: Path
) -> None:
    text = ROBOT.replace(
        "{plugin: memory}",
        "{plugin: memory, options: {url: 'mqtt://me:hush@there', password: hush, "
        "inner: {api_key: hush, token_file: t.txt}}}",
    )
    bridge.emitter("clicks", COUNT)
    with make_robot(text).record("counter", path=tmp_path / "run.mcap"):
        pass
    octets = (tmp_path / "run.mcap").read_bytes()
    assert b"hush" not in octets
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file)
        attachments = {item.name: json.loads(item.data) for item in reader.iter_attachments()}
        metadata = {item.name: item.metadata for item in reader.iter_metadata()}
        summary = reader.get_summary()
    assert summary is not None
    options = attachments["configuration.json"]["bridges"]["memory"]["options"]
    assert options["inner"]["token_file"] == "t.txt"
    assert attachments["plan-counter.json"]["function"] == "counter"
    assert metadata["uoarm.counts"]["counter received"] == "0"
    channels = {channel.topic: channel.metadata for channel in summary.channels.values()}
    assert channels["/counter"]["uoarm.component"] == "clicks"
    stated = json.loads(channels["/counter"]["uoarm.structure"])
    assert stated["schema"] == COUNT


def test_viewers_can_read_the_schema_of_each_channel(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    pair = {"type": "array", "prefixItems": [{"type": "number"}], "items": False}
    path, eye = tmp_path / "run.mcap", bridge.emitter("eye", closed(data=OCTETS, pair=pair))
    clicks = bridge.emitter("clicks", COUNT)
    with make_robot().record("camera", "counter", path=path, queue=BLOCK):
        eye.emit({"data": b"x", "pair": [1.5]})
        clicks.emit({"n": 1})
    schemas = {item.topic: json.loads(item.schema.data) for item in messages(path) if item.schema}
    assert schemas.keys() == {"/camera", "/counter", "/uoarm/events"}
    assert schemas["/camera"]["properties"] == {
        "data": {"type": "string", "contentEncoding": "base64"}
    }
    for schema in schemas.values():
        for part in (schema, *schema["properties"].values()):
            assert isinstance(part["type"], str)
            assert part["type"] != "object" or "properties" in part


def test_a_takeover_is_in_the_file_with_its_gap(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    eye, spare = bridge.emitter("eye", COUNT), bridge.emitter("spare", COUNT)
    robot = make_robot()
    with robot.record("camera", path=tmp_path / "run.mcap", queue=BLOCK) as recording:
        reported: list[str] = []
        robot.listen(lambda event: reported.append(event.subject))  # after the recording is
        eye.emit({"n": 1})
        bridge.die("eye")
        wait(lambda: bool(spare.channels()), "it has happened")
        wait(lambda: bool(robot.connections()[0].gaps), "it has happened")
        spare.emit({"n": 2})
        wait(lambda: robot.connections()[0].gaps[0].counted, "it has happened")
        wait(lambda: "component eye" in reported, "it has happened")
    (path,) = recording.status().files
    assert read_json_of(path, "/camera") == [{"n": 1}, {"n": 2}]
    events = read_json_of(path, "/uoarm/events")
    gaps = [event["gap"] for event in events if event["change"] == "gap"]
    assert [(gap["before"], gap["after"]) for gap in gaps] == [(["eye"], ["spare"])]
    assert any(event["subject"] == "component eye" for event in events)


def test_gaps_that_a_connection_has_forgotten_hide_no_later_one(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection_runtime, "_GAPS", 2)
    bridge.emitter("eye", COUNT)
    robot, names = make_robot(), ["eye", "spare"]
    with robot.record("camera", path=tmp_path / "run.mcap", queue=BLOCK) as recording:
        (connection,) = robot.connections()
        for number in range(5):
            here, there = names[number % 2], names[(number + 1) % 2]
            bridge.emitter(there, COUNT)
            bridge.die(here)
            wait(partial(has_moved_to, connection, there))
    (path,) = recording.status().files
    events = read_json_of(path, "/uoarm/events")
    times = [event["gap"]["time"] for event in events if "gap" in event]
    assert times == sorted(set(times))
    assert times[-1] == connection.gaps[-1].time


def has_moved_to(connection: Connection, component: str) -> bool:
    """Say whether its last gap leads to a component, with what was lost in it."""
    gaps = connection.gaps
    return bool(gaps) and gaps[-1].counted and gaps[-1].after == (component,)


def test_what_finds_no_room_before_the_writer_is_counted_and_seen_in_the_numbers(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    clicks = bridge.emitter("clicks", COUNT)
    robot = make_robot()
    queue = QueuePolicy(length=3)
    with robot.record("counter", path=tmp_path / "run.mcap", queue=queue) as recording:
        writer = hang_writer(recording)
        clicks.emit({"n": 0})
        assert writer.entered.wait(patience())
        for n in range(1, 11):
            clicks.emit({"n": n})
        writer.release()
    status = recording.status()
    assert status.dropped == {"queue-full": 7}
    assert (status.channels[0].received, status.channels[0].recorded) == (11, 4)
    (path,) = status.files
    counted = of_topic(path, "/counter")
    assert [message.sequence for message in counted] == [1, 9, 10, 11]


def test_a_message_that_has_no_form_costs_itself_only(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    def write(message: Message) -> bytes:
        if message == 2:
            raise SystemExit("one of its values quits")
        return written(message)

    clicks = bridge.emitter("clicks", True)
    with make_robot().record("counter", path=tmp_path / "run.mcap") as recording:
        clicks.emit(1)
        [track] = recording._tracks
        wait(lambda: track.form is not None)
        assert track.form is not None
        written = track.form.encode
        track.form = attrs.evolve(track.form, encode=write)
        for value in ("half of a pair: \ud800", 2, 3):
            clicks.emit(value)
    assert recording.status().channels[0].unwritable == 2
    assert read_json_of(recording.status().files[0], "/counter") == [1, 3]


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_a_new_file_begins_and_each_is_whole(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path, compression: str
) -> None:
    clicks = bridge.emitter("clicks", COUNT)
    recording = make_robot().record(
        "counter", path=tmp_path / "run.mcap", split=20_000, compression=compression, queue=BLOCK
    )
    with recording:
        for n in range(3000):
            clicks.emit({"n": n})
    files = recording.status().files
    assert len(files) > 2
    assert files[1].endswith("run-1.mcap")
    numbers = [item["n"] for file in files for item in read_json_of(file, "/counter")]
    assert numbers == list(range(3000))


def test_a_file_after_which_none_can_begin_is_counted_once(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    clicks, folder = bridge.emitter("clicks", COUNT), tmp_path / "stick"
    folder.mkdir()
    recording = make_robot().record(
        "counter", path=folder / "run.mcap", split=20_000, compression="none", queue=BLOCK
    )
    folder.rename(tmp_path / "unplugged")
    while not recording.ended:
        clicks.emit({"n": 1})
    status = recording.status()
    assert (status.state, "cannot be made" in status.cause) == ("failed", True)
    assert status.octets == (tmp_path / "unplugged" / "run.mcap").stat().st_size


def test_a_file_that_is_there_stays(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    bridge.emitter("clicks", COUNT)
    (tmp_path / "run.mcap").write_text("mine")
    with make_robot().record("counter", path=tmp_path / "run.mcap") as recording:
        pass
    assert (tmp_path / "run.mcap").read_text() == "mine"
    assert recording.status().files == (str(tmp_path / "run-1.mcap"),)


def test_it_ends_with_its_functions(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    clicks = bridge.emitter("clicks", COUNT)
    with make_robot().record("counter", path=tmp_path / "run.mcap") as recording:
        clicks.emit({"n": 1})
        bridge.die("clicks")
        assert recording.wait(patience())
    assert recording.status().cause == "every function has ended"
    assert read_json_of(recording.status().files[0], "/counter") == [{"n": 1}]


def test_it_ends_when_it_has_its_size_and_with_the_manager(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    clicks = bridge.emitter("clicks", COUNT)
    robot = make_robot()
    first = robot.record("counter", path=tmp_path / "a.mcap", max_size="10kB", queue=BLOCK)
    while not first.ended:
        clicks.emit({"n": 1})
    assert first.status().cause == "its files have 10,000 octets"
    second = robot.record("counter", path=tmp_path / "b.mcap")
    clicks.emit({"n": 2})
    robot.close()
    assert second.ended
    assert read_json_of(tmp_path / "b.mcap", "/counter") == [{"n": 2}]


def test_a_disk_that_is_full_already_is_refused_before_anything_is_opened(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    bridge.emitter("clicks", COUNT)
    robot = make_robot()
    with full_after(0), pytest.raises(UsageError, match=r"cannot be written: .*File too large"):
        robot.record("counter", path=tmp_path / "run.mcap")
    assert not list(tmp_path.glob("*.mcap"))
    assert not robot.status().components


def test_a_full_disk_ends_the_recording_and_nothing_else(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    clicks = bridge.emitter("clicks", COUNT)
    robot = make_robot()
    events: list[str] = []
    robot.listen(lambda event: events.append(str(event)))
    came: list[Any] = []
    with robot.request("counter", on_message=came.append) as beside:
        with full_after(50_000):
            recording = Recording(
                robot,
                ["counter"],
                tmp_path / "run.mcap",
                RecordOptions(compression="none", chunk_octets=10_000, queue=BLOCK),
                robot._events,
            )
            sent = 0
            while not recording.ended:
                clicks.emit({"n": sent})
                sent += 1
        status = recording.status()
        clicks.emit({"n": sent})
        assert not beside.ended
    assert (status.state, "File too large" in status.cause) == ("failed", True)
    wait(lambda: any("recording run.mcap failed" in event for event in events), "it has happened")
    assert len(came) == sent + 1
    # What is there ends with a whole record, and nothing else is counted as recorded.
    numbers = [
        json.loads(record.data)["n"]
        for record in readable(tmp_path / "run.mcap")
        if type(record).__name__ == "Message" and b'"n"' in record.data
    ]
    assert numbers == list(range(len(numbers)))
    assert numbers
    (channel,) = status.channels
    assert channel.recorded == len(numbers)
    assert status.dropped["unwritten"] > 0
    assert status.octets == (tmp_path / "run.mcap").stat().st_size


def test_what_cannot_be_recorded_is_refused_and_leaves_nothing(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    bridge.emitter("clicks", COUNT)
    robot = make_robot()
    with pytest.raises(ResolutionError):
        robot.record("counter", "camera", path=tmp_path / "run.mcap")
    with pytest.raises(UsageError, match="there is no folder"):
        robot.record("counter", path=tmp_path / "none" / "run.mcap")
    with pytest.raises(UsageError, match=r"^split: 'often' is neither a size nor a time"):
        robot.record("counter", path=tmp_path / "run.mcap", split="often")
    with pytest.raises(UsageError, match=r"^max_size: 'much' is no size"):
        robot.record("counter", path=tmp_path / "run.mcap", max_size="much")
    with pytest.raises(UsageError, match="compression"):
        robot.record("counter", path=tmp_path / "run.mcap", compression="rar")
    with pytest.raises(UsageError, match="named twice"):
        robot.record("counter", "counter", path=tmp_path / "run.mcap")
    with pytest.raises(UsageError, match="expected a text"):
        robot.record(["counter"], path=tmp_path / "run.mcap")  # type: ignore[arg-type]
    for ring in (None, 5.0):
        with pytest.raises(UsageError, match="is a folder"):
            robot.record("counter", path=tmp_path, ring=ring)
        with pytest.raises(UsageError, match="is no regular file"):
            robot.record("counter", path=os.devnull, ring=ring)
        for name in ("x" * 300, "a\0b"):
            with pytest.raises(UsageError, match="cannot be made"):
                robot.record("counter", path=tmp_path / name, ring=ring)
    assert list(tmp_path.iterdir()) == []
    assert robot.connections() == ()


def test_recordings_that_begin_together_share_no_file(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    bridge.emitter("clicks", COUNT)
    (tmp_path / "run.mcap").symlink_to(tmp_path / "nowhere")
    robot = make_robot()
    with ThreadPoolExecutor(8) as pool:
        begun = [pool.submit(robot.record, "counter", path=tmp_path / "run.mcap") for _ in range(8)]
        files = {recording.result().status().files for recording in begun}
    assert files == {(str(tmp_path / f"run-{number}.mcap"),) for number in range(1, 9)}


def test_a_step_of_the_clock_begins_a_new_file(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    clicks = bridge.emitter("clicks", COUNT)
    now = [Instant(10**18, 0)]
    robot = make_robot()
    recording = Recording(
        robot,
        ["counter"],
        tmp_path / "run.mcap",
        RecordOptions.of(queue=BLOCK),
        robot._events,
        clock=lambda: now[0],
    )
    with recording:
        clicks.emit({"n": 1})
        now[0] = Instant(10**18 + 1000, 1000)
        clicks.emit({"n": 2})
        now[0] = Instant(10**18 - 3600 * 10**9, 2000)
        clicks.emit({"n": 3})
    first, second = recording.status().files
    assert [item["n"] for item in read_json_of(first, "/counter")] == [1, 2]
    assert [item["n"] for item in read_json_of(second, "/counter")] == [3]
    split = read_json_of(first, "/uoarm/events")[-1]
    assert split["cause"] == "the clock was set by -3600.000 s"


def test_a_ring_is_written_on_demand_and_on_a_failure(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    clicks, eye = bridge.emitter("clicks", COUNT), bridge.emitter("eye", COUNT)
    now = [Instant(10**18, 0)]
    robot = make_robot()
    recording = Recording(
        robot,
        ["counter", "camera"],
        tmp_path / "run.mcap",
        RecordOptions.of(ring=5.0, queue=BLOCK),
        robot._events,
        clock=lambda: now[0],
    )
    with recording:
        assert list(tmp_path.iterdir()) == []
        for second in range(10):
            now[0] = Instant(10**18 + second * 10**9, second * 10**9)
            clicks.emit({"n": second})
        path = recording.dump("a user wants to know")
        assert [item["n"] for item in read_json_of(path, "/counter")] == [4, 5, 6, 7, 8, 9]
        eye.emit({"n": 100})
        bridge.die("eye")
        wait(lambda: len(recording.status().files) > 1, "it has happened")
    second_file = recording.status().files[1]
    assert [item["n"] for item in read_json_of(second_file, "/camera")] == [100]
    assert "lost" in read_json_of(second_file, "/uoarm/events")[-1]["cause"]
    with pytest.raises(UsageError, match="has ended"):
        recording.dump()


def test_what_fails_together_is_in_one_file_of_a_ring(
    bridge: MemoryBridge, make_robot: Any, tmp_path: Path
) -> None:
    names = [f"sensor{number}" for number in range(10)]
    functions = "".join(
        f"  {name}: {{components: [{{name: {name}_, bridge: memory,"
        f" output: {{endpoint: [{name}]}}}}]}}\n"
        for name in names
    )
    emitters = [bridge.emitter(name, COUNT) for name in names]
    robot = make_robot(
        f"version: 1\nbridges: {{memory: {{plugin: memory}}}}\nfunctions:\n{functions}"
    )
    failed: list[str] = []
    robot.listen(lambda event: failed.append(event.subject) if event.change == "failed" else None)
    with robot.record(*names, path=tmp_path / "run.mcap", ring=60) as recording:
        for number, emitter in enumerate(emitters):
            emitter.emit({"n": number})
        for name in names[1:]:
            bridge.die(name)
        wait(lambda: len(failed) == len(names) - 1, "the others have failed")
        wait(lambda: recording.status().files, "it is written")
        emitters[0].emit({"n": 100})
        path = recording.dump()
    first, second = recording.status().files
    assert path == second
    assert {message.topic for message in messages(first)} == {
        "/uoarm/events",
        *(f"/{name}" for name in names),
    }
    assert [item["n"] for item in read_json_of(second, "/sensor0")] == [100]


def test_it_says_that_it_was_closed(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where it is closed while the writer looks whether the functions have ended."""
    bridge.emitter("clicks", COUNT)
    looks, closed = threading.Event(), threading.Event()

    def are_all_ended(_: Recording) -> bool:
        looks.set()
        return closed.wait(patience())

    monkeypatch.setattr(Recording, "_are_all_ended", property(are_all_ended))
    robot = make_robot()
    recording = robot.record("counter", path=tmp_path / "run.mcap")
    assert looks.wait(patience())
    closing = Background(recording.close)
    wait(lambda: not robot.connections())
    closed.set()
    closing.result()
    assert recording.status().cause == ""


def test_a_ring_counts_what_messages_cost_beside_their_own() -> None:
    ring = Ring(60.0, 1_000_000)
    for number in range(10_000):
        ring.keep(KeptMessage(EVENTS, Instant(number, number), b"", number))
        ring.trim(Instant(number, number))
    assert len(list(ring)) < 5000


def test_a_ring_that_is_not_written_in_time_says_so_and_is_written_later(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    clicks = bridge.emitter("clicks", COUNT)
    robot, options = make_robot(), RecordOptions.of(ring=60.0, queue=BLOCK)
    recording = Recording(robot, ["counter"], tmp_path / "run.mcap", options, robot._events)
    with recording:
        writer = hang_writer(recording)
        clicks.emit({"n": 1})
        with pytest.raises(UsageError, match=r"not written after 0\.01 s"):
            recording.dump(timeout=0.01)
        writer.release()
        wait(lambda: recording.status().files, "it is written later")
    assert read_json_of(recording.status().files[0], "/counter") == [{"n": 1}]


def test_a_ring_ends_when_its_files_have_their_size(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    bridge.emitter("clicks", COUNT)
    with make_robot().record("counter", path=tmp_path / "a.mcap", ring=1, max_size=10) as recording:
        recording.dump()
        assert recording.wait(patience())
    assert recording.status().cause == "its files have 10 octets"


KILLED = """
import sys
from uoarm import RobotManager
from uoarm.config import loads
from uoarm.model import QueuePolicy
from uoarm.testing import MemoryBridge

bridge = MemoryBridge()
clicks = bridge.emitter("clicks", {"type": "object", "properties": {"n": {"type": "integer"}},
                                   "required": ["n"], "additionalProperties": False})
robot = RobotManager(loads(sys.argv[2]), bridges={"memory": bridge})
queue = QueuePolicy(length=100, policy="block", timeout=600)
recording = robot.record("counter", path=sys.argv[1], queue=queue)
n = 0
while True:
    clicks.emit({"n": n})
    n += 1
    if n % 1000 == 0:
        print(n, flush=True)
"""


# Seven turns end at as many parts of a chunk, which holds 6,900 messages.
@pytest.mark.parametrize(
    "turn", [*range(7), *(pytest.param(turn, marks=pytest.mark.long) for turn in range(7, 20))]
)
def test_kill_9_loses_the_last_chunk_at_most(tmp_path: Path, turn: int) -> None:
    path = tmp_path / "run.mcap"
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, str(path), ROBOT], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        for _ in range(2 + turn * 3):
            sent = int(process.stdout.readline())
        process.send_signal(signal.SIGKILL)
        rest = process.stdout.read().split()
    sent = int(rest[-1]) if rest else sent
    records = readable(path)
    numbers = [
        json.loads(record.data)["n"]
        for record in records
        if type(record).__name__ == "Message" and b'"n"' in record.data
    ]
    assert numbers == list(range(len(numbers)))
    # A chunk has 256 KiB, so at most so many of these messages; the queue has a hundred.
    assert len(numbers) >= sent - 262_144 // 38 - 100


@pytest.mark.parametrize("ring", [None, 60.0])
@pytest.mark.parametrize("is_closed", [True, False])
def test_what_happened_before_its_end_is_in_the_file(
    bridge: MemoryBridge,
    make_robot: MakeRobot,
    tmp_path: Path,
    is_closed: bool,
    ring: float | None,
) -> None:
    """Also while a listener holds up all that listen after it."""
    clicks = bridge.emitter("clicks", COUNT)
    robot, go_on = make_robot(), threading.Event()

    def hold_up(event: StatusEvent) -> None:
        del event
        go_on.wait(patience())

    robot.listen(hold_up)
    try:
        with robot.record("counter", path=tmp_path / "run.mcap", ring=ring) as recording:
            clicks.emit({"n": 1})
            bridge.die("clicks")
            if is_closed:
                wait(lambda: not robot.connections(), "it has happened")
            else:
                assert recording.wait(patience())
    finally:
        go_on.set()
    files = recording.status().files
    assert read_json_of(files[0], "/counter") == [{"n": 1}]
    events = [event for file in files for event in read_json_of(file, "/uoarm/events")]
    happened = [(event["subject"].partition(" ")[0], event["change"]) for event in events]
    assert ("component", "lost") in happened
    assert ("connection", "failed") in happened


def test_that_a_function_has_ended_is_in_the_file_though_its_state_is_seen_first(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bridge.emitter("clicks", COUNT)
    robot, kills = make_robot(), threading.Event()
    announce, kill = Driver._announce, Connection.kill

    def announce_late(driver: Driver, action: Announce) -> None:
        if action.change == "failed":
            kills.wait(patience())
        announce(driver, action)

    def kill_seen(connection: Connection) -> None:
        kills.set()
        kill(connection)

    monkeypatch.setattr(Driver, "_announce", announce_late)
    monkeypatch.setattr(Connection, "kill", kill_seen)
    with robot.record("counter", path=tmp_path / "run.mcap") as recording:
        bridge.die("clicks")
        assert recording.wait(patience())
    events = read_json_of(recording.status().files[0], "/uoarm/events")
    assert "failed" in [event["change"] for event in events]


def test_events_that_find_no_room_before_the_writer_are_counted(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(_recording, "_MOST_EVENTS", 3)
    clicks = bridge.emitter("clicks", COUNT)
    robot = make_robot()
    with robot.record("counter", path=tmp_path / "run.mcap") as recording:
        writer = hang_writer(recording)
        clicks.emit({"n": 1})
        assert writer.entered.wait(patience())
        for number in range(10):
            robot._events.post("test", str(number))
        writer.release()
    status = recording.status()
    (path,) = status.files
    changes = [event["change"] for event in read_json_of(path, "/uoarm/events")]
    left = [change for change in changes if change.isdigit()]
    assert left == [str(number) for number in range(10 - len(left), 10)]
    assert status.dropped == {"events": 10 - len(left)}
    assert summary(status).endswith(f"\n  {10 - len(left)} events lost before the writer")
    assert len(left) < 4


def hang_writer(recording: Recording) -> Hang:
    """Have the writer hang at each message of the first function, until it is released."""
    form, hang = recording._tracks[0].form, Hang()
    assert form is not None
    encode = form.encode

    def slow(message: Message) -> bytes:
        hang.wait()
        return encode(message)

    object.__setattr__(form, "encode", slow)
    return hang


def test_a_recording_that_finds_no_thread_leaves_nothing_open(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path
) -> None:
    bridge.emitter("clicks", COUNT)
    robot = make_robot()
    with no_threads("uoarm-recording"), pytest.raises(RuntimeError, match="new thread"):
        robot.record("counter", path=tmp_path / "run.mcap")
    assert robot.connections() == ()
    assert list(tmp_path.iterdir()) == []


def test_a_recording_that_is_left_while_its_opening_is_undone_leaves_no_file(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bridge.emitter("clicks", COUNT)
    robot = make_robot()

    def refuse(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Recording, "_open", refuse)
    monkeypatch.setattr(Recording, "_kill", refuse)
    with pytest.raises(KeyboardInterrupt):
        robot.record("counter", path=tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("ring", [None, 60])
def test_a_file_may_have_a_name_that_is_no_text(
    bridge: MemoryBridge, make_robot: MakeRobot, tmp_path: Path, ring: float | None
) -> None:
    clicks, path = bridge.emitter("clicks", COUNT), tmp_path / os.fsdecode(b"run\xff.mcap")
    with make_robot().record("counter", path=path, queue=BLOCK, ring=ring) as recording:
        clicks.emit({"n": 1})
        wait(lambda: recording.status().channels[0].received)
        if ring is not None:
            recording.dump()
    status = recording.status()
    assert (status.state, status.channels[0].recorded) == ("ended", 1)


def test_the_lock_of_the_configuration_is_attached_unless_it_is_no_file(tmp_path: Path) -> None:
    robot = Robot({}, {}, origin=str(tmp_path / "cart.yaml"))
    (tmp_path / "robot.lock").write_text("of another robot")
    assert [name for name, _ in documents(robot, {})] == ["configuration.json"]
    (tmp_path / "cart.lock").write_text("what it rests on")
    assert ("cart.lock", b"what it rests on") in documents(robot, {})
    (tmp_path / "cart.lock").unlink()
    os.mkfifo(tmp_path / "cart.lock")  # reading it would wait for ever
    assert [name for name, _ in documents(robot, {})] == ["configuration.json"]
