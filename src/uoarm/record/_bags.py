"""Recordings of ROS 1, and of rosbag2 in its other formats, read with the package rosbags."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from uoarm._origin import install_command
from uoarm.errors import BridgeError, FailureReason, PluginError
from uoarm.record._reading import FileChannel, StoredMessage

__all__ = ["BagReader"]


class BagReader:
    """A file `.bag` of ROS 1, or a folder of rosbag2.

    Args:
        path: of the file or folder.

    Raises:
        BridgeError: it is not there, or cannot be read.
        PluginError: rosbags is not installed.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[str] = []
        self._channels: dict[str, FileChannel] = {}
        reader = self._open()
        try:
            self.start = int(reader.start_time) if reader.message_count else 0
            # Theirs is the time behind the last message.
            self.end = int(reader.end_time) - 1 if reader.message_count else 0
            is_two = bool(reader.is2)
            for connection in reader.connections:
                known = self._channels.setdefault(
                    connection.topic, _channel(connection, is_two=is_two)
                )
                if known.schema_name != connection.msgtype:
                    self.notes.append(f"{connection.topic} has messages of two types: one is read")
        finally:
            reader.close()

    @property
    def channels(self) -> Mapping[str, FileChannel]:
        """The channels by topic."""
        return self._channels

    def messages(
        self, topic: str, since: int, on_damage: Callable[[str], object]
    ) -> Iterator[StoredMessage]:
        """Yield the messages of a topic from a time on, in the order of their times."""
        reader, wanted = self._open(), self._channels[topic].schema_name
        try:
            connections = [
                connection
                for connection in reader.connections
                if connection.topic == topic and connection.msgtype == wanted
            ]
            for _, time, data in reader.messages(connections, start=since):
                yield StoredMessage(time, data)
        except GeneratorExit:
            raise
        except Exception as error:  # noqa: BLE001 - of a library, with errors of its own
            on_damage(f"{self.path} cannot be read on: {error}")
        finally:
            reader.close()

    def _open(self) -> Any:
        try:
            from rosbags.highlevel import AnyReader  # noqa: PLC0415 - an extra
        except ImportError as error:
            command = install_command("uoarm", "bags")
            raise PluginError(f"recordings of this kind need: {command} ({error})") from error
        if not self.path.exists():
            raise BridgeError(f"there is no {self.path}", FailureReason.UNAVAILABLE)
        try:
            reader = AnyReader([self.path])
            reader.open()
        except Exception as error:
            text = f"{self.path} cannot be read: {type(error).__name__}: {error}"
            raise BridgeError(text, FailureReason.UNSUPPORTED) from error
        return reader


def _channel(connection: Any, *, is_two: bool) -> FileChannel:
    definition = connection.msgdef
    kind = str(definition.format.name).lower()
    is_text = kind == "msg"
    encodings = ("cdr", "ros2msg") if is_two else ("ros1", "ros1msg")
    name = str(connection.msgtype)
    return FileChannel(
        str(connection.topic),
        encodings[0],
        # rosbags spells types of ROS 1 as ROS 2 does.
        name,
        encodings[1] if is_text else f"ros2{kind}",
        str(definition.data).encode(),
    )
