"""Recordings over the native protocol: begun, ended, written and played by those who may."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.record.conftest import COUNT, of_topic
from tests.server.conftest import Serve
from tests.server.talk import Talk

from uoarm import RobotManager
from uoarm.client import connect
from uoarm.config import loads
from uoarm.errors import ConfigurationError
from uoarm.model import QueuePolicy
from uoarm.server import Limits, Server, hash_token
from uoarm.testing import Emitter, MemoryBridge, wait

ROBOT = """
version: 1
bridges:
  memory: {plugin: memory}
  tape: {plugin: recording, options: {file: FILE, paused: true}}
functions:
  counter: {components: [{name: clicks, bridge: memory, output: {endpoint: [clicks]}}]}
  other: {components: [{name: more, bridge: memory, output: {endpoint: [more]}}]}
  then: {components: [{name: of_then, bridge: tape, output: {endpoint: [/counter]}}]}
"""
ACCESS = """
version: 1
roles:
  looks: {see: ["counter", "then"], request: ["*"]}
  records: {see: ["counter", "other"], request: ["*"], record: ["counter"]}
  records_too: {see: all, request: ["*"], record: ["*"]}
  leads: {see: all, request: ["*"], record: all, kill: ["*"]}
tokens:
"""
NAMES = ("looks", "records", "records_too", "leads")


@pytest.fixture
def bridge() -> Iterator[MemoryBridge]:
    made = MemoryBridge()
    yield made
    made.close()


@pytest.fixture
def clicks(bridge: MemoryBridge) -> Emitter:
    bridge.emitter("more", COUNT)
    return bridge.emitter("clicks", COUNT)


@pytest.fixture
def robot(bridge: MemoryBridge, clicks: Emitter, tmp_path: Path) -> Iterator[RobotManager]:
    tape, then = tmp_path / "then.mcap", MemoryBridge()
    once = then.emitter("clicks", COUNT)
    with RobotManager(loads(ROBOT.replace("FILE", str(tape))), bridges={"memory": then}) as first:
        queue = QueuePolicy(length=100, policy="block", timeout=600)
        with first.record("counter", path=tape, queue=queue):
            for n in range(5):
                once.emit({"n": n})
    made = RobotManager(loads(ROBOT.replace("FILE", str(tape))), bridges={"memory": bridge})
    yield made
    made.close()


@pytest.fixture
def access(tmp_path: Path) -> Path:
    path = tmp_path / "access.yaml"
    lines = "".join(f"- {{name: {n}, role: {n}, sha256: {hash_token(n)}}}\n" for n in NAMES)
    path.write_text(ACCESS + lines, encoding="utf-8")
    return path


def talk(server: Server, name: str = "") -> Talk:
    headers = {"Authorization": f"Bearer {name}"} if name else {}
    return Talk(f"ws://127.0.0.1:{server.ports[0]}/", additional_headers=headers)


def test_a_client_records_and_looks_at_what_was_recorded(
    serve: Serve, clicks: Emitter, tmp_path: Path
) -> None:
    folder = tmp_path / "kept"
    with talk(serve(recordings=folder)) as client:
        client.ask("Status", "watch")
        begun = client.ask("Record", "", {"functions": ["counter"], "compression": "none"})
        name = begun["recording"]
        assert (begun["state"], begun["may_stop"], begun["ring"]) == ("recording", True, None)
        changes = iter(lambda: client.next("change")["jsonMessage"], None)
        assert next(c for c in changes if c["subject"].startswith("recording"))["change"] == "began"
        clicks.emit({"n": 7})
        wait(lambda: client.ask("Record", name)["channels"][0]["recorded"] == 1)
        ended = client.ask("Record", name, {"stop": True})
        assert (ended["state"], ended["channels"][0]["recorded"]) == ("ended", 1)
        (path,) = ended["files"]
        assert Path(path).parent == folder
        assert [message.data for message in of_topic(path, "/counter")] == [b'{"n":7}']
        listed = client.ask("Record")
        assert [item["recording"] for item in listed["recordings"]] == [name]
        assert [(file["path"], file["octets"]) for file in listed["files"]] == [
            (path, Path(path).stat().st_size)
        ]
        assert client.refused("Record", name, {"dump": True})["code"] == "usage"
        assert client.refused("Record", "r99", {"stop": True})["code"] == "unknown"
        assert client.refused("Record", "", {"functions": ["none"]})["code"] == "resolution"
        assert client.refused("Record", "", {"stop": True})["code"] == "usage"


def test_what_is_kept_in_memory_is_written_when_a_client_asks(
    serve: Serve, clicks: Emitter, tmp_path: Path
) -> None:
    with talk(serve(recordings=tmp_path / "kept")) as client:
        name = client.ask("Record", "", {"functions": ["counter"], "ring": 60})["recording"]
        clicks.emit({"n": 1})
        wait(lambda: client.ask("Record", name)["channels"][0]["recorded"] == 1)
        written = client.ask("Record", name, {"dump": True})
        assert [message.data for message in of_topic(written["written"], "/counter")]
        assert written["files"] == [written["written"]]


def test_a_recording_goes_on_without_the_client_that_began_it(
    serve: Serve, robot: RobotManager, tmp_path: Path
) -> None:
    server = serve(recordings=tmp_path / "kept")
    with talk(server) as client:
        name = client.ask("Record", "", {"functions": ["counter"]})["recording"]
    with talk(server) as client:
        assert client.ask("Record", name)["state"] == "recording"
    assert [item.id for item in robot.recordings() if not item.ended] == [name]


def test_what_clients_record_is_bounded(serve: Serve, tmp_path: Path) -> None:
    folder = tmp_path / "kept"
    limits = Limits(recordings=1, recordings_bytes=10)
    with talk(serve(limits, recordings=folder)) as client:
        name = client.ask("Record", "", {"functions": ["counter"]})["recording"]
        assert client.refused("Record", "", {"functions": ["counter"]})["code"] == "limit"
        client.ask("Record", name, {"stop": True})
        full = client.refused("Record", "", {"functions": ["counter"]})
        assert full["code"] == "limit"
        assert "remove some" in full["text"]


def test_a_folder_that_cannot_be_used_keeps_the_server_from_starting(
    serve: Serve, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(ConfigurationError, match=r"recordings cannot be written to .*file/kept: "):
        serve(recordings=tmp_path / "file" / "kept")


def test_a_folder_that_is_gone_is_said_to_who_records(serve: Serve, tmp_path: Path) -> None:
    folder = tmp_path / "kept"
    with talk(serve(recordings=folder)) as client:
        folder.rmdir()
        folder.touch()
        refused = client.refused("Record", "", {"functions": ["counter"]})
        assert refused["code"] == "usage"
        assert f"recordings cannot be written to {folder}: " in refused["text"]


def test_a_recording_ends_when_it_has_what_one_may_have(
    serve: Serve, robot: RobotManager, clicks: Emitter, tmp_path: Path
) -> None:
    with talk(serve(Limits(recording_bytes=5000), recordings=tmp_path / "kept")) as client:
        wanted = {"functions": ["counter"], "max_size": "1GB"}
        name = client.ask("Record", "", wanted)["recording"]
        (recording,) = robot.recordings()

        def ended() -> bool:
            clicks.emit({"n": 1})
            return recording.ended

        wait(ended)
        assert client.ask("Record", name)["cause"] == "its files have 5,000 octets"


def test_rights_say_who_records_stops_and_plays(
    serve: Serve, access: Path, robot: RobotManager, tmp_path: Path
) -> None:
    server = serve(access=access, recordings=tmp_path / "kept")
    own = robot.record("counter", path=tmp_path / "own.mcap")
    with talk(server, "looks") as client:
        assert client.refused("Record", "", {"functions": ["counter"]})["code"] == "denied"
        (shown,) = client.ask("Record")["recordings"]
        assert (shown["files"], shown["may_stop"]) == (["own.mcap"], False)
        assert "files" not in client.ask("Record")
        (player,) = client.ask("Play")["players"]
        assert (player["bridge"], player["may_move"]) == ("tape", False)
        assert client.refused("Play", "tape", {"pause": False})["code"] == "denied"
    with talk(server, "records") as client:
        assert client.refused("Record", "", {"functions": ["counter", "other"]})["code"] == "denied"
        mine = client.ask("Record", "", {"functions": ["counter"]})["recording"]
        refused = client.refused("Record", own.id, {"stop": True})
        assert (refused["code"], "kill" in refused["text"]) == ("denied", True)
        assert client.ask("Play") == {"players": []}
        assert client.refused("Play", "tape", {"pause": False})["code"] == "unknown"
    both = robot.record("counter", "other", path=tmp_path / "both.mcap")
    with talk(server, "looks") as client:
        assert both.id not in [item["recording"] for item in client.ask("Record")["recordings"]]
        assert client.refused("Record", both.id)["code"] == "unknown"
    with talk(server, "records_too") as client:
        assert client.refused("Record", mine, {"stop": True})["code"] == "denied"
        assert client.ask("Play", "tape", {"pause": True})["is_paused"]
    with talk(server, "leads") as client:
        for name in (own.id, mine, both.id):
            assert client.ask("Record", name, {"stop": True})["state"] == "ended"


def test_a_recording_is_paused_stepped_and_sought_over_the_wire(serve: Serve) -> None:
    with talk(serve()) as client:
        (player,) = client.ask("Play")["players"]
        assert player["is_paused"]
        assert (player["functions"], player["file"]) == (["then"], "then.mcap")
        then = client.open("then")
        numbers: list[Any] = []
        for _ in range(2):
            client.ask("Play", "tape", {"step": True})
            numbers += client.data(then, 1)
        assert numbers == [{"n": 0}, {"n": 1}]
        assert client.ask("Play", "tape", {"seek": 0})["position"] == 0
        client.ask("Play", "tape", {"step": True})
        assert client.data(then, 1) == [{"n": 0}]
        assert client.ask("Play", "tape", {"rate": "fast", "pause": False})["rate"] is None
        assert client.data(then, 4) == [{"n": n} for n in range(1, 5)]
        assert client.refused("Play", "tape", {"rate": -1})["code"] == "unreadable"
        assert client.refused("Play", "memory", {"pause": True})["code"] == "unknown"
        assert client.refused("Play", "", {"pause": True})["code"] == "usage"


async def test_the_client_of_python_records_and_plays(serve: Serve, tmp_path: Path) -> None:
    server = serve(recordings=tmp_path / "kept")

    async with connect(f"ws://127.0.0.1:{server.ports[0]}/") as robot:
        begun = await robot.record("counter", ring=5.0)
        name = begun["recording"]
        dumped = await robot.dump_recording(name)
        assert dumped["files"] == [dumped["written"]]
        assert (await robot.stop_recording(name))["state"] == "ended"
        listed = await robot.recordings()
        assert [item["recording"] for item in listed["recordings"]] == [name]
        assert [player["bridge"] for player in await robot.players()] == ["tape"]
        assert not (await robot.playback("tape", pause=False, rate=2.0))["is_paused"]
        assert (await robot.playback("tape"))["rate"] == 2.0
