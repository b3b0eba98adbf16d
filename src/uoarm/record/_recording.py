"""A recording that runs: a callback on each function's messages, one queue, one writing thread."""

from __future__ import annotations

import logging
import math
import os
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, TypeAlias

from typing_extensions import Self

from uoarm._encodable import encodable
from uoarm._interrupts import put_off, wait_for
from uoarm._raised import LimitedLog, Log, contained, on_failure, reason_of, sentence_of, text_of
from uoarm.errors import UoarmError, UsageError
from uoarm.model import Gap, Message, StatusEvent
from uoarm.record._arrivals import (
    Arrivals,
    ReadOctets,
    RecordedEvents,
    RecordedFunction,
    RecordedRobot,
)
from uoarm.record._file import (
    KeptMessage,
    McapFile,
    Ring,
    documents,
    event_message,
    gap_message,
    require_mcap,
    require_room,
)
from uoarm.record._forms import EVENTS, form_of, ros_events
from uoarm.record._options import (
    Instant,
    RecordedChannel,
    RecordingSchedule,
    RecordingStatus,
    RecordingStep,
    RecordOptions,
)

_log = Log("uoarm")
_CLOSE_SECONDS = 60.0
_GLANCE_SECONDS = 1.0
_TURN_MESSAGES = 1024
"""After which the writer lets those go first who bring messages."""
_MOST_EVENTS = 10_000
_FAILURES = frozenset({"lost", "failed"})


_Item: TypeAlias = "tuple[RecordedFunction, int, int, Message, int]"
"""As `Arrivals` has it."""


def _now() -> tuple[int, int]:
    return time.time_ns(), time.monotonic_ns()


class Recording:
    """Messages of functions on their way into files, until `close` or the end of its own.

    Made by `RobotManager.record`. A context manager. All methods may be called from any thread.

    Attributes:
        id: by which `RobotManager.recordings` knows it.
        functions: that are recorded.
    """

    def __init__(
        self,
        robot: RecordedRobot,
        functions: Sequence[str],
        path: Path,
        options: RecordOptions,
        events: RecordedEvents,
        *,
        timeout: float = 60.0,
        clock: Callable[[], tuple[int, int]] = _now,
        identity: str = "r1",
    ) -> None:
        require_mcap()
        self.id, self.functions = identity, tuple(functions)
        if not functions:
            raise UsageError("a recording is of one function at least")
        if len(set(map(str, functions))) < len(functions):
            raise UsageError("a function is named twice")
        if not os.path.isdir(path.parent):
            raise UsageError(f"{path} cannot be made: there is no folder {path.parent}")
        self._path, self._options, self._moment = path, options, clock
        self._robot, self._report, self._observe = robot, events.post, events.observe
        self._dropped: Counter[str] = Counter()
        # Guards the counter, which the threads of all functions and the writer count up.
        self._counting = threading.Lock()
        # Appended to by whatever thread posts an event, one at a time; taken from by the writer.
        self._events: deque[tuple[Instant, StatusEvent]] = deque(maxlen=_MOST_EVENTS)
        # Of the next event; a later one in its place says how many found no room.
        self._next_event = 0
        self._wanted: deque[tuple[str, Future[str] | None]] = deque()
        self._event_form = EVENTS
        self._ring = None if options.ring is None else Ring(options.ring, options.ring_octets)
        self._unwritten_failure = ""
        self._file: McapFile | None = None
        self._files: list[str] = []
        self._octets_before = 0
        self._state, self._cause = "recording", ""
        self._records = LimitedLog(_log)
        self._is_closing = False
        self._finished = threading.Event()
        self._last = self._began = self._clock()
        self._ended: Instant | None = None
        self._schedule = RecordingSchedule(options, self._last)
        self._tracks = [RecordedFunction(function) for function in functions]
        self._arrivals: Arrivals[RecordedFunction] = Arrivals(
            options.queue, self._tracks, self._drop
        )
        self._end_observing: Callable[[], None] = lambda: None
        if options.ring is None:
            # Before anything is opened: a path that cannot be written costs no connection.
            self._file = self._begin_file()
        else:
            require_room(path)
        self._thread = threading.Thread(target=self._run, name="uoarm-recording", daemon=True)
        # Two: a second Ctrl-C leaves a kill that hangs, and no file.
        with on_failure(self._discard), on_failure(self._kill):
            self._open(timeout)
            self._report(self._subject, "began", ", ".join(self.functions))
            self._thread.start()

    def status(self) -> RecordingStatus:
        """Return what has come and what was written so far."""
        file = self._file
        with self._counting:
            dropped = dict(self._dropped)
        now = self._ended or self._clock()
        return RecordingStatus(
            self._state,
            self._cause,
            tuple(self._files),
            self._octets_before + (0 if file is None else file.octets),
            tuple(
                RecordedChannel(
                    track.function,
                    "" if track.form is None else track.form.topic,
                    "" if track.form is None else track.form.message_encoding,
                    track.received,
                    track.recorded,
                    track.unwritable,
                    track.failure,
                )
                for track in self._tracks
            ),
            dropped,
            (now.steady - self._began.steady) / 1e9,
        )

    @property
    def ring(self) -> float | None:
        """The seconds that it keeps in memory; None: it writes everything."""
        return self._options.ring

    @property
    def ended(self) -> bool:
        """Whether its last file is closed."""
        return self._finished.is_set()

    def wait(self, timeout: float | None = None) -> bool:
        """Wait until it has ended by itself; False when `timeout` seconds were too few."""
        return wait_for(self._finished, timeout)

    def dump(self, cause: str = "it was asked for", *, timeout: float = 60.0) -> str:
        """Write what the ring holds into a file, and return its path.

        Raises:
            UsageError: it has no ring, has ended, or its file cannot be written, or is not within
                `timeout` seconds: it is written still, once the disk takes it.
        """
        if self._options.ring is None:
            raise UsageError("this recording writes everything: only one with a ring is dumped")
        written: Future[str] = Future()
        done = threading.Event()
        written.add_done_callback(lambda _: done.set())
        self._wanted.append((cause, written))
        self._arrivals.press()
        if self.ended and not written.done():
            raise UsageError("the recording has ended")
        if not wait_for(done, timeout):
            text = f"the ring is not written after {timeout:g} s: it will be, once there is time"
            raise UsageError(text)
        try:
            return written.result()
        except OSError as error:
            raise UsageError(f"the ring cannot be written: {reason_of(error)}") from error

    def close(self) -> None:
        """End it: write what has come, close the file. Idempotent; waits a minute at most."""
        if put_off(self.close):
            return
        self._is_closing = True
        self._kill()
        self._arrivals.close()
        if threading.current_thread() is not self._thread:
            wait_for(self._finished, _CLOSE_SECONDS)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        functions = ", ".join(track.function for track in self._tracks)
        return f"<Recording of {functions} into {self._path}: {self._state}>"

    # What follows until `_run` is called by the thread that made it, or that of messages or events.

    def _open(self, timeout: float) -> None:
        self._end_observing = self._observe(self._take_event)
        for track in self._tracks:
            connection = self._robot.request(
                track.function,
                validate="off",
                on_message=self._arrivals.taker(track, self._moment),
                timeout=timeout,
            )
            track.connection = connection
            step = connection.plan.provider
            if connection.output is None:
                raise UsageError(f"function {track.function!r} has no output to record")
            output = step.component.output(connection.output)
            assert output is not None, "the connection has it"
            metadata = {"uoarm.component": step.component.name}
            endpoint = output.endpoint
            if "qos" in endpoint.options:
                metadata["uoarm.qos"] = str(endpoint.options["qos"])
            structure = step.structures[f"output.{connection.output}"]
            track.form = form_of(track.function, structure, metadata)
            if track.form.message_encoding == "cdr":
                track.definition = track.form.schema_data.decode()

        forms = [track.form for track in self._tracks if track.form is not None]
        if all(form.message_encoding == "cdr" for form in forms):
            self._event_form = ros_events()

    def _take_event(self, event: StatusEvent) -> None:
        if not self._next_event:  # nothing has been taken yet
            self._next_event = event.number
        self._events.append((self._clock(), event))
        kind = event.subject.partition(" ")[0]
        if self._options.ring is not None and event.change in _FAILURES and kind != "recording":
            self._wanted.append((str(event), None))
        if kind == "connection" or self._wanted:
            self._arrivals.press()

    def _clock(self) -> Instant:
        return Instant(*self._moment())

    def _drop(self, reason: str, count: int = 1) -> None:
        if count:
            with self._counting:
                self._dropped[reason] += count

    def _kill(self) -> None:
        for track in self._tracks:
            if track.connection is not None:
                track.connection.kill()
        # After that: a kill returns when all that happened before it has been announced.
        self._end_observing()

    def _discard(self) -> None:
        if self._file is not None:
            self._file.abandon()
            self._file.path.unlink(missing_ok=True)

    # What follows is called by the writer alone.

    def _run(self) -> None:
        try:
            self._write_all()
        except OSError as error:
            self._fail(f"{self._path}: {reason_of(error, self._path)}")
        except Exception as error:  # noqa: BLE001 - whatever it is, it ends the recording only
            self._fail(text_of(error))
        finally:
            self._arrivals.close()
            self._kill()
            for _ in self._arrivals.take_waiting():
                self._drop("closed")
            self._ended = self._clock()
            if self._ring is not None:
                self._ring.clear()
            self._report(self._subject, self._state, self._cause)
            self._finished.set()
            # After that: what `dump` asks for later finds that it has ended.
            while self._wanted:
                written = self._wanted.popleft()[1]
                if written is not None:
                    written.set_exception(UsageError("the recording has ended"))

    @property
    def _subject(self) -> str:
        return f"recording {encodable(self._path.name)}"

    def _write_all(self) -> None:
        while True:
            is_closed, file = self._arrivals.is_closed, self._file
            waiting = file is not None and file.has_waiting
            wait = self._schedule.wait(self._clock(), waiting=waiting)
            self._arrivals.wait(_GLANCE_SECONDS if wait is None else min(wait, _GLANCE_SECONDS))
            wanted = len(self._wanted)  # before that: what came before a wish is in what is taken
            items = self._arrivals.take_waiting()
            ring = self._ring
            goes_on = self._write(items) if ring is None else self._keep_all(ring, items)
            if ring is not None:
                self._write_wanted(ring, wanted)
            if not goes_on:
                break
            if is_closed and not items:
                break
            is_idle = not items and not len(self._arrivals)
            # In this order: `close` says that it closes before it ends the connections.
            if is_idle and self._are_all_ended and not self._is_closing:
                self._kill()  # that a connection has ended is seen before it is announced
                self._cause = "every function has ended"
                break
        self._finish()

    def _write(self, items: list[_Item]) -> bool:
        """Write what came, and what is due; False where the recording ends with it."""
        file = self._file
        assert file is not None, "only a ring has none"
        events, is_quiet, left = self._events, self._schedule.is_quiet, len(items)
        try:
            for place, (track, wall, steady, message, number) in enumerate(items):
                if events or not is_quiet(wall, steady, file.octets):
                    found = self._look(file, Instant(wall, steady))
                    if found is None:
                        return False
                    file = found
                left -= 1
                data = self._encoded(track, message)
                if data is not None:
                    assert track.form is not None, "it was opened"
                    track.recorded += 1
                    file.add_message(track.form, wall, data, number)
                if not place % _TURN_MESSAGES:
                    self._last = Instant(wall, steady)
                    time.sleep(0)
        finally:
            self._drop("closed", left)
        if not items:
            return self._look(file, self._clock()) is not None
        self._last = Instant(*items[-1][1:3])
        return True

    def _look(self, file: McapFile, at: Instant) -> McapFile | None:
        """Do what is due at a moment; returns the file to write into, None where it ends."""
        before, self._last = self._last, at
        due = self._schedule.due(
            at,
            file_octets=file.octets,
            all_octets=self._octets_before + file.octets,
            waiting=file.has_waiting,
        )
        if due is RecordingStep.END:
            self._cause = self._schedule.end_cause
            return None
        if due is RecordingStep.SPLIT:
            file = self._split(at, before)
        elif due is RecordingStep.FLUSH:
            file.flush()
            self._schedule.flushed(at)
        if not file.has_channels:
            self._describe(file, at)
        self._write_events(file)
        return file

    @property
    def _are_all_ended(self) -> bool:
        return all(track.connection is None or track.connection.ended for track in self._tracks)

    def _encoded(self, track: RecordedFunction, message: Message) -> bytes | None:
        assert track.form is not None, "it was opened"
        if type(message) is ReadOctets:
            return message.octets
        try:
            return track.form.encode(message)
        except BaseException as error:  # noqa: BLE001 - of a value's own methods, say
            track.unwritable += 1
            why = sentence_of(contained(error))
            text = f"{self._subject}: a message of {track.function}: {why}"
            self._records.write(logging.WARNING, text)
            return None

    def _begin_file(self) -> McapFile:
        options = self._options
        file = McapFile(self._path, options.compression, options.chunk_octets)
        self._files.append(str(file.path))
        self._schedule.file_begins(self._clock())
        return file

    def _describe(self, file: McapFile, at: Instant) -> None:
        """Write what a file has before its first message."""
        events = self._event_form
        file.begin("ros2" if events.message_encoding == "cdr" else "")
        plans = {
            track.function: track.connection.plan
            for track in self._tracks
            if track.connection is not None
        }
        for name, content in documents(self._robot.config, plans):
            media = "application/json" if name.endswith(".json") else "application/yaml"
            file.attach(name, content, media, at.wall)
        file.add_metadata(
            "uoarm.recording",
            {"functions": ", ".join(plans), "began": str(at.wall), "number": str(len(self._files))},
        )
        file.add_channel(events)
        for track in self._tracks:
            assert track.form is not None, "it was opened"
            file.add_channel(track.form)

    def _split(self, at: Instant, before: Instant) -> McapFile:
        file = self._file
        assert file is not None, "only a ring has none"
        self._write_events(file)
        # With the time of what came last: this one may be of a clock that was set back.
        self._write_event(file, before, self._own_event("split", self._schedule.split_cause))
        self._end_file(file)
        self._file = file = self._begin_file()
        self._describe(file, at)
        return file

    def _own_event(self, change: str, cause: str) -> Mapping[str, Any]:
        return {"subject": self._subject, "change": change, "cause": cause, "function": ""}

    def _take_events(self, until: float = math.inf) -> Iterator[tuple[Instant, Mapping[str, Any]]]:
        while self._events and self._events[0][0].steady <= until:
            at, event = self._events.popleft()
            self._drop("events", event.number - self._next_event)
            self._next_event = event.number + 1
            yield at, event_message(event)

    def _write_events(self, file: McapFile) -> None:
        for at, event in self._take_events():
            self._write_event(file, at, event)

    def _write_event(self, file: McapFile, at: Instant, event: Mapping[str, Any]) -> None:
        if not file.has_channels:
            self._describe(file, at)
        self._add_event(file, at, event)
        for track in self._tracks:
            connection = track.connection
            if connection is None or event["subject"] != f"connection {connection.id}":
                continue
            # Of a gap it is known what was lost in it once all that died is closed.
            for gap in track.new_gaps():
                if not gap.counted:
                    break
                self._write_gap(file, at, track, gap)

    def _write_gap(self, file: McapFile, at: Instant, track: RecordedFunction, gap: Gap) -> None:
        assert track.connection is not None, "it was opened"
        track.gaps, track.last_gap = track.gaps + 1, gap.time
        self._add_event(file, at, gap_message(track.function, track.connection.id, gap))

    def _add_event(self, file: McapFile, at: Instant, event: Mapping[str, Any]) -> None:
        file.add_message(self._event_form, at.wall, self._event_form.encode(event), 0)

    def _end_file(self, file: McapFile) -> None:
        """Write what a file has behind its last message."""
        at = self._clock()
        if not file.has_channels:
            self._describe(file, at)
        for track in self._tracks:
            for gap in track.new_gaps():
                self._write_gap(file, at, track, gap)
        with self._counting:
            dropped = dict(self._dropped)
        counts = {
            f"{track.function} {name}": str(count)
            for track in self._tracks
            for name, count in (
                ("received", track.received),
                ("recorded", track.recorded),
                ("unwritable", track.unwritable),
                ("gaps", track.gaps),
            )
        }
        losses = {f"dropped {reason}": str(count) for reason, count in dropped.items()}
        file.add_metadata("uoarm.counts", counts | losses)
        file.finish()
        # Not that of now any more: the next may fail to begin, and its octets are counted once.
        self._file = None
        self._octets_before += file.octets

    def _finish(self) -> None:
        file = self._file
        if self._ring is not None:
            self._finish_ring(self._ring)
        if file is not None:
            self._write_events(file)
            event = self._own_event("ended", self._cause or "it was closed")
            self._write_event(file, self._clock(), event)
            self._end_file(file)
        self._state = "ended"

    def _fail(self, cause: str) -> None:
        """End it after what cannot be mended, such as a full disk: the file has what is whole."""
        self._state, self._cause = "failed", cause
        file, self._file = self._file, None
        if file is not None:
            try:
                for track in self._tracks:
                    count = 0 if track.form is None else file.unwritten(track.form)
                    track.recorded -= count
                    self._drop("unwritten", count)
                file.abandon()
            except OSError as error:
                _log.warning("%s: %s", self._subject, reason_of(error))
            self._octets_before += file.octets

    # The ring.

    def _keep_all(self, ring: Ring, items: list[_Item]) -> bool:
        """Keep what came, for as long as it is; False where the recording ends."""
        for track, wall, steady, message, number in items:
            at = Instant(wall, steady)
            self._keep_events(ring, at)
            data = self._encoded(track, message)
            if data is not None:
                assert track.form is not None, "it was opened"
                ring.keep(KeptMessage(track.form, at, data, number))
                track.recorded += 1
        now = self._clock()
        self._keep_events(ring, now)
        ring.trim(now)
        due = self._schedule.due(now, file_octets=0, all_octets=self._octets_before, waiting=False)
        if due is RecordingStep.END:
            self._cause = self._schedule.end_cause
        return due is not RecordingStep.END

    def _keep_events(self, ring: Ring, until: Instant) -> None:
        for at, event in self._take_events(until.steady):
            ring.keep(KeptMessage(self._event_form, at, self._event_form.encode(event), 0))

    def _write_wanted(self, ring: Ring, count: int) -> None:
        """Write the ring into one file for all that want it now.

        Only events after a failure, such as what else failed with it, wait for the next file.
        """
        wanted = [self._wanted.popleft() for _ in range(count)]
        calls = [written for _, written in wanted if written is not None]
        self._unwritten_failure = self._unwritten_failure or (wanted[0][0] if wanted else "")
        is_new = calls or not self._files or ring.has_other_than(self._event_form)
        if not (wanted and is_new):
            return
        found: str | Exception
        try:
            found = self._write_ring(ring, self._unwritten_failure)
        except (OSError, UoarmError) as error:
            found = error
            self._records.write(logging.ERROR, f"{self._subject}: {reason_of(error)}")
        for written in calls:
            written.set_result(found) if isinstance(found, str) else written.set_exception(found)

    def _finish_ring(self, ring: Ring) -> None:
        """Write what is left where something failed, also what has only just."""
        self._keep_events(ring, self._clock())
        self._write_wanted(ring, len(self._wanted))
        if self._unwritten_failure:
            self._write_ring(ring, self._unwritten_failure)

    def _write_ring(self, ring: Ring, cause: str) -> str:
        """Write what is kept into a file of its own; it is gone from the ring then."""
        file, now = self._begin_file(), self._clock()
        try:
            self._describe(file, now)
            for kept in ring:
                file.add_message(kept.form, kept.at.wall, kept.data, kept.sequence)
            self._write_event(file, now, self._own_event("written", cause))
            self._end_file(file)
        except OSError:
            file.abandon()
            raise
        ring.clear()
        self._unwritten_failure = ""
        self._report(self._subject, "written", f"{encodable(str(file.path))}: {cause}")
        return str(file.path)
