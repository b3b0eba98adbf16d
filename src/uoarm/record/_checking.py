"""Whether what was recorded passes today's configuration: by proof, and message for message.

Recordings of ROS 1, and of rosbag2 in its other formats, are read with the package rosbags.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any, Protocol

from attrs import define, frozen

from uoarm._adapt import MappingError, UnfitError, adapt, check_edge, parse
from uoarm._origin import install_command
from uoarm._raised import reason_of
from uoarm._support.files import open_regular
from uoarm.bridge import message_check
from uoarm.errors import BridgeError, FailureReason, MessageError, PluginError, UoarmError
from uoarm.model import (
    Component,
    Input,
    Message,
    MessageStructure,
    Reason,
    Robot,
)
from uoarm.record._file import require_mcap
from uoarm.record._forms import EVENTS_TOPIC, reading_of
from uoarm.record._reading import FileChannel, McapReader, RecordedFile, StoredMessage
from uoarm.record._records import MAGIC


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
        self.channels: dict[str, FileChannel] = {}
        self._kinds: dict[str, tuple[object, ...]] = {}
        reader = self._open()
        try:
            # A folder says of its times what recorders knew of them, as of its last file only.
            parts = [file.metadata for file in _files(reader)] or [reader]
            parts = [part for part in parts if part.message_count]
            self.start = min((int(part.start_time) for part in parts), default=0)
            # Theirs is the time behind the last message.
            self.end = max((int(part.end_time) - 1 for part in parts), default=0)
            if not 0 <= self.start < _LATEST or not 0 <= self.end < _LATEST:
                raise BridgeError(
                    f"{path}: expected times in nanoseconds below 2**63, got {self.start} to "
                    f"{self.end}",
                    FailureReason.UNSUPPORTED,
                )
            is_two = bool(reader.is2)
            for connection in reader.connections:
                topic, kind = str(connection.topic), _kind(connection)
                self.channels.setdefault(topic, _channel(connection, is_two=is_two))
                note = f"{topic} has messages of two types or definitions: the first is read"
                if self._kinds.setdefault(topic, kind) != kind and note not in self.notes:
                    self.notes.append(note)
        finally:
            reader.close()

    def messages(
        self, topic: str, since: int, on_damage: Callable[[str], object]
    ) -> Iterator[StoredMessage]:
        """Yield the messages of a topic from a time on, in the order of their times."""
        reader, wanted = self._open(), self._kinds[topic]
        try:
            connections = [
                connection
                for connection in reader.connections
                if connection.topic == topic and _kind(connection) == wanted
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
        if not os.path.exists(self.path):
            raise BridgeError(f"there is no {self.path}", FailureReason.UNAVAILABLE)
        try:
            reader = AnyReader([self.path])
            reader.open()
            _files(reader).sort(key=lambda file: int(file.metadata.start_time))
        except Exception as error:
            text = (
                f"{self.path} cannot be read: expected an MCAP file, a .bag of ROS 1 or a folder "
                f"of rosbag2 ({reason_of(error)}){self._advice(error)}"
            )
            raise BridgeError(text, FailureReason.UNSUPPORTED) from error
        return reader

    def _advice(self, error: Exception) -> str:
        """Return what helps against an error of rosbags, beginning with a semicolon."""
        if self.path.suffix == ".bag" and self.path.is_file():
            return "; `rosbag reindex` makes the index of a bag that was cut short"
        if not self.path.is_dir():
            return ""
        if "no type definitions" in str(error):
            return (
                "; its recorder wrote no definitions, as before Iron: `ros2 bag convert` to mcap, "
                "where its packages are installed, adds them"
            )
        readable = sorted(self.path.glob("*.mcap"))
        if readable:
            return f"; give {readable[0]} as the file: what of it is readable is played"
        if not (self.path / "metadata.yaml").exists() and any(self.path.glob("*.db3")):
            return f"; `ros2 bag reindex {self.path}` mends a bag that was cut short"
        return ""


def _files(reader: Any) -> list[Any]:
    """Return the files of a folder of rosbag2, which are read in this order; a .bag has none."""
    storage = getattr(reader.readers[0], "storage", None)
    files: list[Any] = getattr(storage, "storages", [])
    return files


def _kind(connection: Any) -> tuple[object, ...]:
    """Return what decides how messages are read; of one definition publishers send several texts.

    They differ in comments, and have one digest; without a digest there is the text alone.
    """
    return connection.msgtype, connection.digest or connection.msgdef.data


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


_NANO = 1_000_000_000
_LATEST = 2**63  # that of SQLite, and of ROS


class CheckedRobot(Protocol):
    """A manager, as far as a check uses it."""

    @property
    def config(self) -> Robot: ...
    def structures(self, component: str) -> Mapping[str, MessageStructure]: ...


@frozen
class FailedMessage:
    """A message that does not pass.

    Attributes:
        number: of the channel's messages, from 1.
        time: when it was recorded, in UTC.
        seconds: after the first message of the file.
        cause: the field and what is wrong with it.
    """

    number: int
    time: str
    seconds: float
    cause: str


@frozen
class ConsumerCheck:
    """One place at which the messages of a channel are taken today.

    Attributes:
        place: `detector.image`, or the provider of today where no component takes them.
        reasons: why the structure of then is not proven to fit; empty where it is.
        unchecked: why nothing could be held against it; empty where it was.
        passed: messages that fit, adapted first where the configuration says so.
        failed: messages that do not.
        first: the first of those.
    """

    place: str
    reasons: tuple[Reason, ...] = ()
    unchecked: str = ""
    passed: int = 0
    failed: int = 0
    first: FailedMessage | None = None


@frozen
class ChannelCheck:
    """One channel of the recording.

    Attributes:
        topic: of it.
        function: whose messages it has; empty where the configuration has none of its name.
        messages: how many could be read.
        unreadable: how many could not, or parts of the file with any number of them.
        cause: why nothing was checked, or the first thing that cannot be read.
        consumers: where they are taken.
    """

    topic: str
    function: str
    messages: int = 0
    unreadable: int = 0
    cause: str = ""
    consumers: tuple[ConsumerCheck, ...] = ()

    @property
    def is_passed(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.unreadable and not any(
            consumer.reasons or consumer.failed for consumer in self.consumers
        )


@frozen
class RecordingCheck:
    """A whole recording.

    Attributes:
        file: its path.
        channels: those it has, but for the events.
        notes: what of the file cannot be read.
    """

    file: str
    channels: tuple[ChannelCheck, ...]
    notes: tuple[str, ...] = ()

    @property
    def is_passed(self) -> bool:
        """Whether all that could be checked passes, and something could."""
        consumers = [consumer for channel in self.channels for consumer in channel.consumers]
        is_checked = any(not consumer.unchecked for consumer in consumers)
        return is_checked and all(channel.is_passed for channel in self.channels)

    @property
    def is_complete(self) -> bool:
        """Whether nothing was left unchecked: no channel, no consumer, no part of the file."""
        return not self.notes and all(
            channel.consumers and not any(consumer.unchecked for consumer in channel.consumers)
            for channel in self.channels
        )


def open_recording(path: Path) -> RecordedFile:
    """Return a recording of any kind that is read.

    Raises:
        BridgeError: it is not there, or none.
        PluginError: what it takes is not installed.
    """
    require_mcap()
    begin = b""
    with suppress(OSError), open_regular(path) as file:
        begin = file.read(len(MAGIC))  # a recording may have any name
    return McapReader(path) if path.suffix == ".mcap" or begin == MAGIC else BagReader(path)


def check_recording(path: Path, robot: CheckedRobot) -> RecordingCheck:
    """Hold every message of a recording against what takes its function today.

    Raises:
        BridgeError: the recording is not there, or none.
        PluginError: what it takes is not installed.
    """
    file = open_recording(path)
    channels = tuple(
        _check_channel(file, channel, robot)
        for topic, channel in sorted(file.channels.items())
        if topic != EVENTS_TOPIC
    )
    return RecordingCheck(str(path), channels, tuple(file.notes))


@define
class _Consumer:
    """A place while messages are held against it."""

    place: str
    reasons: tuple[Reason, ...] = ()
    unchecked: str = ""
    check: Callable[[Message], object] | None = None
    passed: int = 0
    failed: int = 0
    first: FailedMessage | None = None

    def result(self) -> ConsumerCheck:
        return ConsumerCheck(
            self.place, self.reasons, self.unchecked, self.passed, self.failed, self.first
        )


@define
class _Unreadable:
    count: int = 0
    first: str = ""

    def add(self, why: str) -> None:
        self.count += 1
        self.first = self.first or why


def _check_channel(file: RecordedFile, channel: FileChannel, robot: CheckedRobot) -> ChannelCheck:
    name = channel.metadata.get("uoarm.function") or channel.topic.strip("/").replace("/", ".")
    function, _, port = name.partition(".")
    if function not in robot.config.functions:
        return ChannelCheck(channel.topic, "", cause="the configuration has no such function")
    try:
        reading = reading_of(channel)
    except BridgeError as error:
        return ChannelCheck(channel.topic, name, cause=str(error))
    consumers = list(_consumers(function, port, reading.structure, robot))
    unreadable, count = _Unreadable(), 0
    for message in file.messages(channel.topic, 0, unreadable.add):
        try:
            value = reading.decode(message.data)
        except MessageError as error:
            unreadable.add(str(error))
            continue
        count += 1
        for consumer in consumers:
            if consumer.check is None:
                continue
            try:
                consumer.check(value)
            except MessageError as error:
                consumer.failed += 1
                if consumer.first is None:
                    consumer.first = _failed(count, message.time, file.start, str(error))
            else:
                consumer.passed += 1
    return ChannelCheck(
        channel.topic,
        name,
        count,
        unreadable.count,
        unreadable.first,
        tuple(consumer.result() for consumer in consumers),
    )


def _failed(number: int, time: int, start: int, cause: str) -> FailedMessage:
    moment = datetime.fromtimestamp(time / _NANO, timezone.utc)
    text = moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")
    return FailedMessage(number, text, round((time - start) / _NANO, 6), cause)


def _consumers(
    function: str, port: str, recorded: MessageStructure | None, robot: CheckedRobot
) -> Iterator[_Consumer]:
    """Yield each input that the function feeds; where there is none, what provides it today."""
    found = False
    for component in robot.config.components():
        for item in component.inputs:
            source = item.source
            if source is not None and (source.function, source.port or "") == (function, port):
                found = True
                yield _of_input(component, item, recorded, robot)
    if found:
        return
    for component in robot.config.functions[function].components:
        output = component.output(port or None)
        if output is None or robot.config.bridges[component.bridge].plugin == "recording":
            continue
        place = f"{component.name}.{output.name}"
        try:
            structure = robot.structures(component.name)[f"output.{output.name}"]
        except UoarmError as error:
            yield _Consumer(place, unchecked=str(error))
            continue
        yield _Consumer(place, check=message_check(structure, place))
        return


def _of_input(
    component: Component, item: Input, recorded: MessageStructure | None, robot: CheckedRobot
) -> _Consumer:
    place = f"{component.name}.{item.name}"
    try:
        taken = robot.structures(component.name)[f"input.{item.name}"]
    except UoarmError as error:
        return _Consumer(place, unchecked=str(error))
    reasons: tuple[Reason, ...] = ()
    if recorded is None:
        reasons = (Reason("the file does not state what its messages are like"),)
    else:
        verdict = check_edge(recorded, taken, item.mapping, item.allow_loss, item.meaning)
        reasons = () if verdict.compatible else verdict.reasons
    check = message_check(taken, place)
    if item.mapping is None:
        return _Consumer(place, reasons, check=check)
    try:
        made = adapt(
            parse(item.mapping), True if recorded is None else recorded.schema, taken.schema
        ).make
    except (MappingError, UnfitError) as error:
        return _Consumer(
            place, reasons or (Reason(str(error)),), f"the map cannot be used: {error}"
        )

    def adapted(message: Message) -> None:
        check(made(message))

    return _Consumer(place, reasons, check=adapted)
