"""The bridge `recording`: channels of a recording as outputs of a component."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Mapping
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from attrs import evolve

from uoarm._raised import on_failure, reason_of
from uoarm.bridge import (
    Bridge,
    Capabilities,
    Delivery,
    Description,
    Discovered,
    ServiceStructures,
    Sink,
    Source,
    text_of,
)
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.model import Endpoint, Health, Message, MessageStructure, Role, to_json
from uoarm.record._checking import open_recording
from uoarm.record._file import require_mcap
from uoarm.record._forms import EVENTS_TOPIC, RECORDED, ChannelReading, reading_of
from uoarm.record._playback import (
    CONTROL,
    CONTROL_REPLY,
    CONTROL_REQUEST,
    Playback,
    PlaybackTurn,
    Timeline,
)
from uoarm.record._reading import McapReader, RecordedFile
from uoarm.record.plugin import PlaybackOptions

_NANO = 1_000_000_000
_JOIN_SECONDS = 1.0
_EMPTY_SECONDS = 1.0


class RecordingBridge(Bridge):
    """An endpoint's address is one string, the topic of a channel.

    All outputs that are open follow one timeline. Each has a thread of its own, which waits for its
    consumers: nothing is lost before a queue of theirs.
    """

    capabilities = Capabilities(discover=True, call=True)

    def __init__(self, name: str, options: PlaybackOptions) -> None:
        super().__init__(name, options)
        require_mcap()
        self._path = Path(options.file)
        self._follows, self._loops = options.follow, options.loop
        self._may_move = options.allow_motion
        self._mcap: McapReader | None = None
        self._file: RecordedFile
        if self._follows:
            self._file = self._mcap = McapReader(self._path, follows=True)
        else:
            self._file = open_recording(self._path)
        begin = int(options.from_ * _NANO)
        length = self._file.end - self._file.start
        if begin > length:
            raise BridgeError(
                f"bridge {name!r}: `from` is {begin / _NANO:g} s, and {self._path.name} has "
                f"{length / _NANO:g} s",
                FailureReason.REFUSED,
            )
        is_fast = options.rate == "fast" or self._follows
        rate = None if is_fast else float(options.rate)
        timeline = Timeline(rate, begin, is_paused=options.paused)
        self.playback = Playback(timeline, self._file.start, length, file=self._path.name)

    def facts(self) -> Mapping[str, object]:
        """Return what is played, and what of it cannot be read."""
        notes = {"cannot_be_read": "; ".join(self._file.notes)} if self._file.notes else {}
        status = self.playback.status()
        return {"recorded": self._path.name, "position": status.position, **notes}

    def _describe(self, endpoint: Endpoint) -> Description:
        if endpoint.role is Role.SERVICE:
            self._require_control(endpoint)
            return Description(
                request=MessageStructure(CONTROL_REQUEST), reply=MessageStructure(CONTROL_REPLY)
            )
        structure = self._reading(endpoint).structure
        hint = "" if structure is not None else "the file does not state what it is like"
        return Description(self._marked(structure), hint=hint, note=self._note())

    def _open_source(
        self, endpoint: Endpoint, structure: MessageStructure, deliver: Delivery
    ) -> Source:
        del structure
        return _RecordedSource(self, endpoint, self._reading(endpoint), deliver)

    def _open_sink(self, endpoint: Endpoint, structure: MessageStructure) -> Sink:
        del structure
        raise self._takes_nothing(endpoint)

    def _call(
        self, endpoint: Endpoint, structures: ServiceStructures, message: Message, timeout: float
    ) -> Message:
        del structures, timeout
        self._require_control(endpoint)
        playback = self.playback
        if "rate" in message:
            rate = message["rate"]
            playback.set_rate(None if rate == "fast" else float(rate))
        if "seek" in message:
            playback.seek(message["seek"])
        if message.get("step"):
            playback.step()
        elif "pause" in message:
            playback.pause() if message["pause"] else playback.play()
        return to_json(playback.status())

    def _discover(self) -> tuple[Discovered, ...]:
        endpoints = []
        left_out = []
        for topic in self._file.channels:
            if topic == EVENTS_TOPIC:
                continue
            endpoint = Endpoint(self.name, self._path.stem, Role.OUTPUT, (topic,), topic)
            try:
                endpoints.append((endpoint, self._describe(endpoint)))
            except BridgeError as error:
                left_out.append(str(error))
        detail = "; ".join((self._note(), *left_out))
        return (Discovered(self._path.stem, tuple(endpoints), detail),)

    def _close(self) -> None:
        """Do nothing: what is open belongs to the sources."""

    def _reading(self, endpoint: Endpoint) -> ChannelReading:
        if endpoint.role is Role.INPUT:
            raise self._takes_nothing(endpoint)
        if len(endpoint.address) != 1:
            raise BridgeError(
                f"{endpoint}: expected one topic as the address", FailureReason.BAD_ENDPOINT
            )
        channel = self._file.channels.get(endpoint.address[0])
        if channel is None:
            topics = ", ".join(sorted(self._file.channels)[:20]) or "none"
            text = f"{self._path.name} has no channel {endpoint.address[0]!r}; it has {topics}"
            raise BridgeError("; ".join((text, *self._file.notes)), FailureReason.NOT_FOUND)
        return reading_of(channel)

    def _marked(self, structure: MessageStructure | None) -> MessageStructure | None:
        if structure is None or structure.schema is False:
            return structure
        own: Any = {} if structure.schema is True else structure.schema
        return evolve(structure, schema={**own, RECORDED: "moves" if self._may_move else True})

    def _note(self) -> str:
        began = datetime.fromtimestamp(self._file.start / _NANO, timezone.utc)
        text = f"recorded: {self._path.name}, from {began:%Y-%m-%d %H:%M:%S} UTC"
        return "; ".join((text, *self._file.notes))

    def _require_control(self, endpoint: Endpoint) -> None:
        if endpoint.address != (CONTROL,):
            text = f"{endpoint}: the only service of a recording is {CONTROL}"
            raise BridgeError(text, FailureReason.NOT_FOUND)

    def _takes_nothing(self, endpoint: Endpoint) -> BridgeError:
        text = f"{endpoint}: a recording has no inputs: it gives what was, and takes nothing"
        return BridgeError(text, FailureReason.UNSUPPORTED)

    def ended(self, source: Source, health: Health, cause: str) -> None:
        """Take in that a source has nothing more."""
        self.report(health, cause, channel=source)


class _RecordedSource(Source):
    """One channel that is played, in a thread of its own."""

    def __init__(
        self,
        bridge: RecordingBridge,
        endpoint: Endpoint,
        reading: ChannelReading,
        deliver: Delivery,
    ) -> None:
        super().__init__(endpoint)
        self._bridge, self._reading, self._deliver = bridge, reading, deliver
        self._over = threading.Event()
        self._playback = bridge.playback
        # In the thread that opens: what is written from then on is given.
        self._place = 0
        if bridge._follows and bridge._mcap is not None:  # noqa: SLF001 - its own module
            self._place = bridge._mcap.end_of_records()  # noqa: SLF001 - its own module
        else:
            # A step that is asked for from now on waits for the first message of this channel.
            self._joined = self._playback.join(self, loops=self._is_looping)
        self._thread = threading.Thread(
            target=self._run, name=f"uoarm-{bridge.name}-recording", daemon=True
        )
        with on_failure(self._playback.end, self):  # the system gives no more threads
            self._thread.start()

    def facts(self) -> Mapping[str, object]:
        """Return what is played and where it is."""
        return self._bridge.facts()

    def _close(self) -> None:
        self._over.set()
        self._playback.end(self)
        if threading.current_thread() is not self._thread:
            self._thread.join(_JOIN_SECONDS)  # it may be in a `deliver`, which takes its time

    def _run(self) -> None:
        bridge, topic = self._bridge, self.endpoint.address[0]
        try:
            try:
                if bridge._follows and bridge._mcap is not None:  # noqa: SLF001 - its own module
                    self._follow(topic)
                else:
                    self._play(topic)
            finally:
                self._playback.end(self)  # steps wait for this one no longer
        except BridgeError as error:
            bridge.ended(self, Health.LOST, str(error))
        except OSError as error:
            why = reason_of(error, bridge._path)  # noqa: SLF001
            bridge.ended(self, Health.LOST, f"{bridge._path} cannot be read on: {why}")  # noqa: SLF001
        except Exception as error:  # noqa: BLE001 - whatever it is: consumers wait for no thread
            bridge.ended(self, Health.LOST, f"{bridge._path}: {text_of(error)}")  # noqa: SLF001
        else:
            if not self._over.is_set():
                bridge.ended(self, Health.FINISHED, f"{bridge._path.name} has been played")  # noqa: SLF001

    @property
    def _is_looping(self) -> bool:
        return self._bridge._loops and self._playback.length > 0  # noqa: SLF001 - its own module

    def _follow(self, topic: str) -> None:
        file = self._bridge._mcap  # noqa: SLF001 - its own module
        assert file is not None, "only such a file is followed"
        for message in file.follow(topic, self._place, self._over.wait, self._deliver.unreadable):
            if self._over.is_set():
                return
            self._hand_over(message.data)

    def _play(self, topic: str) -> None:
        bridge, playback = self._bridge, self._playback
        file = bridge._file  # noqa: SLF001 - its own module
        loops = self._is_looping
        begin, lap, generation = self._joined
        while not self._over.is_set():
            turn = PlaybackTurn.PLAY
            messages = file.messages(topic, file.start + begin, self._deliver.unreadable)
            first = next(messages, None)
            playback.begin()
            for message in itertools.chain(() if first is None else (first,), messages):
                place = message.time - file.start + lap * playback.length
                turn = playback.wait(self, place, generation, self._over.is_set)
                if turn is not PlaybackTurn.PLAY:
                    break
                self._hand_over(message.data)
            if turn is PlaybackTurn.STOP:
                return
            if turn is PlaybackTurn.ELSEWHERE:
                begin, lap, generation = playback.join(self, loops=loops)
            elif loops:
                if first is None and begin == 0 and self._over.wait(_EMPTY_SECONDS):
                    return  # there is nothing in this channel, for which no time passes
                begin, lap = 0, lap + 1
            else:
                return

    def _hand_over(self, data: bytes | memoryview) -> None:
        try:
            message = self._reading.decode(data)
        except MessageError as error:
            self._deliver.unreadable(str(error))
        else:
            self._deliver(message)
