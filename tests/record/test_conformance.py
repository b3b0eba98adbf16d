"""The bridge of recordings passes the suite that every bridge passes.

A recording has no inputs. So the world writes what the suite sends into a file, as another process
would, and the bridge follows that.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.structures import closed

from uoarm.bridge import Bridge, Description, Sink
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Endpoint, Message, MessageStructure, Role
from uoarm.record._bridge import RecordingBridge
from uoarm.record._file import McapFile
from uoarm.record._forms import ChannelForm, form_of
from uoarm.record.plugin import PlaybackOptions
from uoarm.testing.conformance import BridgeConformance, Pair, Victim, World

OCTETS: Any = {
    "type": "array",
    "items": {"type": "integer", "minimum": 0, "maximum": 255},
    "x-octets": True,
}
KINDS: dict[str, Any] = {
    "json": {
        "type": "object",
        "properties": {
            "name": {"type": "string"},
            "values": {"type": "array", "items": {"type": "number"}},
            "image": OCTETS,
        },
        "required": ["values"],
        "additionalProperties": False,
    },
    "cdr": closed(
        width={"type": "integer", "minimum": 0, "maximum": 2**32 - 1},
        on={"type": "boolean"},
        data=OCTETS,
    ),
}


class WrittenBridge(RecordingBridge):
    """The bridge, and sinks that write into its file."""

    def __init__(self, world: RecordingWorld) -> None:
        super().__init__("tape", PlaybackOptions(str(world.path), follow=True))
        self._world = world

    def _describe(self, endpoint: Endpoint) -> Description:
        if endpoint.role is Role.INPUT:
            return Description(self._world.structures[endpoint.address[0]])
        return super()._describe(endpoint)

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        form = self._world.forms.get(endpoint.address[0])
        if form is None:
            raise BridgeError(f"{endpoint} is not written", FailureReason.NOT_FOUND)
        return Sink(endpoint, lambda message: self._world.write(form, message), lambda: None)


class RecordingWorld(World):
    """A file that is written as the suite goes on."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.structures = {f"/{kind}": MessageStructure(schema) for kind, schema in KINDS.items()}
        self.forms = {
            topic: form_of(topic[1:], structure, {}) for topic, structure in self.structures.items()
        }
        assert {form.message_encoding for form in self.forms.values()} == {"json", "cdr"}
        self.file = McapFile(path, "none", 1 << 20)
        self.file.begin("")
        for form in self.forms.values():
            self.file.add_channel(form)
            # A chunk without messages is not written, and channels stand in chunks.
        self._number = 0
        self.file.add_message(self.forms["/json"], 0, b'{"values": []}', 0)
        self.file.flush()

    def write(self, form: ChannelForm, message: Message) -> None:
        octets = form.encode(message)
        self._number += 1
        self.file.add_message(form, self._number, octets, self._number)
        self.file.flush()

    def bridge(self) -> Bridge:
        return WrittenBridge(self)

    def pair(self, kind: str) -> Pair:
        return Pair(at(f"/{kind}", Role.INPUT), at(f"/{kind}"))

    def missing(self) -> Endpoint:
        return at("/nowhere")

    def victim(self) -> Victim:
        return Victim(at("/json"), self.path.unlink)

    def samples(self, kind: str) -> list[Message]:
        if kind == "json":
            return [{"values": [1.5, -0.0], "image": b"\0\xff" * 50_000, "name": "Kia ora \u2192"}]
        return [{"width": 2**32 - 1, "on": True, "data": bytes(range(256))}]

    def close(self) -> None:
        self.file.finish()


def at(topic: str, role: Role = Role.OUTPUT) -> Endpoint:
    return Endpoint("tape", f"run{topic}", role, (topic,))


class TestRecordingBridge(BridgeConformance):
    """The whole suite."""

    kinds = ("json", "cdr")

    @pytest.fixture
    def world(self, tmp_path: Path) -> Iterator[World]:
        made = RecordingWorld(tmp_path / "run.mcap")
        yield made
        made.close()


def test_an_input_of_the_bridge_itself_is_refused(tmp_path: Path) -> None:
    world = RecordingWorld(tmp_path / "run.mcap")
    bridge = RecordingBridge("tape", PlaybackOptions(str(world.path)))
    with pytest.raises(BridgeError) as caught:
        bridge.open_sink(at("/json", Role.INPUT), MessageStructure(True))
    assert caught.value.reason is FailureReason.UNSUPPORTED
    bridge.close()
    world.close()
