"""Files of uoarm, opened by readers of others: the same messages come out."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import pytest
from tests.processes import run_program
from tests.record.conftest import COUNT, PICTURE, messages

from uoarm.model import QueuePolicy
from uoarm.testing import MemoryBridge

BLOCK = QueuePolicy(length=1000, policy="block", timeout=600)
READER = """
import { McapStreamReader } from "@mcap/core";
import { readFileSync } from "node:fs";

const reader = new McapStreamReader();
reader.append(readFileSync(process.argv[2]));
const topics = new Map();
for (let record; (record = reader.nextRecord()); ) {
  if (record.type === "Channel") topics.set(record.id, record.topic);
  if (record.type === "Message") {
    const data = Buffer.from(record.data).toString("base64");
    console.log(JSON.stringify([topics.get(record.channelId), String(record.logTime), data]));
  }
}
if (!reader.done()) throw new Error("the file has no end");
"""


@pytest.fixture
def tape(bridge: MemoryBridge, make_robot: Any, tmp_path: Path) -> Path:
    clicks, eye = bridge.emitter("clicks", COUNT), bridge.emitter("eye", PICTURE)
    path = tmp_path / "run.mcap"
    names = ("counter", "camera")
    with make_robot().record(*names, path=path, queue=BLOCK, compression="none"):
        for n in range(200):
            clicks.emit({"n": n})
            eye.emit({"width": n, "name": f"eye {n}", "data": bytes([n % 256]) * n})
    return path


def test_rosbags_reads_a_file_of_ros_2_alone(
    bridge: MemoryBridge, make_robot: Any, tmp_path: Path
) -> None:
    rosbags = pytest.importorskip("rosbags.highlevel", reason="pip install -e '.[bags]'")
    eye, path = bridge.emitter("eye", PICTURE), tmp_path / "run.mcap"
    with make_robot().record("camera", path=path, queue=BLOCK):
        for n in range(200):
            eye.emit({"width": n, "name": f"eye {n}", "data": bytes([n % 256]) * n})
    with rosbags.AnyReader([path]) as reader:
        connections = [item for item in reader.connections if item.topic == "/camera"]
        read = [
            reader.deserialize(data, connection.msgtype)
            for connection, _, data in reader.messages(connections)
        ]
    assert [(picture.width, picture.name, bytes(picture.data)) for picture in read] == [
        (n, f"eye {n}", bytes([n % 256]) * n) for n in range(200)
    ]


@pytest.mark.needs("node", "npm")
def test_a_reader_in_another_language_reads_all(tape: Path, tmp_path: Path) -> None:
    folder = tmp_path / "js"
    folder.mkdir()
    (folder / "package.json").write_text('{"type": "module", "private": true}')
    (folder / "read.js").write_text(READER)
    installed = run_program(
        "npm", "install", "--no-audit", "--no-fund", "--ignore-scripts", "@mcap/core@2", cwd=folder
    )
    if installed.returncode:
        pytest.skip(f"@mcap/core cannot be installed: {installed.stderr.strip()[-200:]}")
    done = run_program("node", "read.js", tape, cwd=folder)
    assert done.returncode == 0, done.stderr
    read = [json.loads(line) for line in done.stdout.splitlines()]
    found = [(topic, int(time), base64.b64decode(data)) for topic, time, data in read]
    wanted = [(message.topic, message.log_time, message.data) for message in messages(tape)]
    assert sorted(found) == sorted(wanted)
    assert len(found) > 400
