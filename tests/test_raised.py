"""What foreign code raises: whose failure it is, its text, and how many records it makes."""

from __future__ import annotations

import asyncio
import builtins
import logging
import re
import signal
import socket
import ssl
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from uoarm._interrupts import Uninterrupted
from uoarm._raised import (
    ContainedError,
    LimitedLog,
    Log,
    foreign,
    is_raised,
    on_failure,
    reason_of,
    sentence_of,
    text_of,
    writable,
)
from uoarm.config import loads
from uoarm.errors import (
    BridgeError,
    ConfigurationError,
    ConnectionClosedError,
    FailureReason,
    MessageError,
)
from uoarm.testing import ManualClock


@pytest.mark.parametrize(
    ("error", "own"),
    [
        (ValueError("no"), True),
        (BridgeError("its reply is none", FailureReason.BAD_MESSAGE), True),
        (BridgeError("no link", FailureReason.UNAVAILABLE), False),
        (MessageError("a field is missing"), False),
        (ConnectionClosedError("it has ended"), False),
    ],
)
def test_what_is_closed_away_or_unfit_is_nobodys_exception(error: Exception, own: bool) -> None:
    assert is_raised(error) is own


def _raised(call: Callable[[], object]) -> BaseException:
    with pytest.raises(Exception) as raised:  # noqa: PT011 - whatever it is, its words are the test
        call()
    return raised.value


def test_why_the_system_refused_is_said_without_a_class_or_a_number(tmp_path: Path) -> None:
    absent = tmp_path / "absent"
    error = _raised(absent.read_text)
    assert reason_of(error, absent) == "No such file or directory"
    assert reason_of(error) == f"No such file or directory: '{absent}'"
    assert reason_of(_raised(lambda: socket.create_connection(("127.0.0.1", 9)))) == (
        "Connection refused"
    )
    assert reason_of(_raised(lambda: socket.getaddrinfo("nohost.invalid", 1))) == (
        "there is no host of this name"
    )
    assert reason_of(_raised(lambda: ssl.create_default_context(cafile=__file__))) == (
        "no certificate or crl found"
    )
    assert reason_of(_raised(Path("a\0b").read_text)) == "embedded null byte"
    place = absent / "link"
    assert reason_of(_raised(lambda: place.symlink_to("x")), place) == "No such file or directory"
    assert reason_of(BridgeError("no link")) == "no link"
    assert reason_of(KeyError("x")) == "KeyError: 'x'"


async def test_why_a_loop_does_not_connect_is_said_without_the_addresses() -> None:
    for host in ("127.0.0.1", "localhost"):  # which may have two
        with pytest.raises(OSError, match="Connect call failed") as raised:
            await asyncio.open_connection(host, 9)
        assert reason_of(raised.value) == "Connection refused"
    both = OSError(
        "Multiple exceptions: [Errno 111] Connect call failed ('::1', 9, 0, 0), [Errno 1"
        "11] Connect call failed ('127.0.0.1', 9)"
    )
    assert reason_of(both) == "Connection refused"
    with pytest.raises(asyncio.TimeoutError) as late:
        await asyncio.wait_for(asyncio.Event().wait(), 0)
    assert reason_of(late.value) == "no answer in time"


def test_the_reason_of_an_error_of_others_is_bounded_and_never_raises() -> None:
    class BrokenError(OSError):
        def __str__(self) -> str:
            raise ValueError("even this")

    assert reason_of(BrokenError()) == "BrokenError, whose text raised ValueError"
    assert reason_of(OSError(5, "\udcff" * 5000)) == "\\udcff" * 166 + "\\udc"
    assert reason_of(OSError()) == "OSError"
    wrong = OSError("Could not configure port: (25, 'Inappropriate ioctl for device')")
    assert reason_of(wrong) == "Could not configure port: Inappropriate ioctl for device"


def test_the_text_of_an_error_is_bounded_and_never_raises() -> None:
    class Broken(Exception):  # noqa: N818 - as foreign code may call it
        def __str__(self) -> str:
            raise OSError("even this")

    assert text_of(Broken()) == "Broken, whose text raised OSError"
    assert len(text_of(ValueError("x" * 10_000))) == 1000
    assert len(text_of(ValueError("\ud800" * 1000))) == 1000


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (KeyboardInterrupt(), "KeyboardInterrupt"),
        (ValueError(" \n"), "ValueError"),
        (ValueError("too hot\n"), "ValueError: too hot"),
        (ValueError("\ud800"), "ValueError: \\ud800"),
        (MessageError(), "MessageError"),
        (BridgeError(""), "BridgeError"),
    ],
)
def test_a_text_is_complete_and_can_be_written(error: BaseException, text: str) -> None:
    assert text_of(error) == text


def test_an_error_of_uoarm_without_a_text_says_its_kind() -> None:
    assert str(MessageError()) == sentence_of(MessageError()) == "MessageError"
    assert sentence_of(MessageError("a field is missing")) == "a field is missing"
    assert sentence_of(TimeoutError()) == "TimeoutError"


def test_no_text_of_an_exception_is_put_together_elsewhere() -> None:
    by_hand = re.compile(r"type\((\w+)\)\.__name__\}: \{\1\}")
    root = Path(__file__).parents[1]
    sources = [*root.glob("src/**/*.py"), *root.glob("plugins/*/src/**/*.py")]
    assert [path for path in sources if by_hand.search(path.read_text("utf-8"))] == []


def test_records_beyond_the_limit_are_counted_in_the_next_one(
    caplog: pytest.LogCaptureFixture,
) -> None:
    clock = ManualClock()
    log = LimitedLog(logging.getLogger("uoarm.test"), burst=2, clock=clock)
    for number in range(5):
        log.write(logging.WARNING, f"record {number}")
    clock.advance(10)
    log.write(logging.WARNING, "record 5")
    assert [record.getMessage() for record in caplog.records] == [
        "record 0",
        "record 1",
        "record 5 (and 3 more since the last record)",
    ]


def chained(length: int) -> Exception:
    made = ValueError("first")
    for number in range(length):
        following = ValueError(str(number))
        following.__cause__ = following.__context__ = made
        made = following
    return made


def grouped(depth: int) -> BaseException:
    group: Any = getattr(builtins, "ExceptionGroup", None)  # from CPython 3.11 on
    if group is None:
        return chained(100_000)
    made: Exception = ValueError("first")
    for _ in range(depth):
        made = group("twice the same", [made, made])
    return made


@pytest.mark.parametrize(
    "make",  # as it is needed, not by each worker that collects
    [lambda: ValueError("x" * 50_000_000), lambda: chained(100_000), lambda: grouped(60)],
    ids=["text", "chain", "group"],
)
def test_the_record_of_an_error_is_bounded_whatever_is_in_it(
    make: Callable[[], BaseException], caplog: pytest.LogCaptureFixture
) -> None:
    """A group of two that are the same, sixty times over, has more members than memory has room."""
    error = make()
    try:
        quit_with(error)
    except Exception as raised:  # noqa: BLE001 - as it was given
        LimitedLog(logging.getLogger("uoarm.test")).write(logging.WARNING, "it failed", raised)
    assert len(caplog.text) < 10_000
    assert "quit_with(error)" in caplog.text
    assert f"{type(error).__name__}: {str(error)[:20]}" in caplog.text


class Hiding(Exception):  # noqa: N818 - of a component
    @property
    def __cause__(self) -> BaseException:  # type: ignore[override]
        raise SystemExit


class Quitting(logging.Handler):
    def handle(self, record: logging.LogRecord) -> bool:
        raise SystemExit(record.getMessage())


def test_a_record_that_cannot_be_written_keeps_nothing_from_what_follows_it() -> None:
    logger, handler = logging.getLogger("uoarm.test"), Quitting()
    logger.addHandler(handler)
    try:
        LimitedLog(logger).write(logging.WARNING, "it failed")
    finally:
        logger.removeHandler(handler)
    LimitedLog(logger).write(logging.WARNING, "it failed", Hiding())


@pytest.mark.parametrize("error", [ValueError("no"), chained(40)])
def test_an_error_of_a_usual_size_is_written_whole(error: Exception) -> None:
    assert writable(error) is error


class Own(BaseException):
    """A kind of foreign code's own."""


def quit_with(error: BaseException) -> None:
    raise error


def in_thread(call: Any) -> BaseException:
    """Return what a call raises in another thread."""
    raised: list[BaseException] = []

    def work() -> None:
        try:
            call()
        except BaseException as error:  # noqa: BLE001 - handed to the test
            raised.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    return raised[0]


@pytest.mark.parametrize(
    "error", [SystemExit(3), asyncio.CancelledError(), GeneratorExit(), Own("no")]
)
def test_what_foreign_code_raises_is_an_exception_of_it_in_every_thread(
    error: BaseException,
) -> None:
    with pytest.raises(ContainedError) as caught:
        foreign(quit_with, error)
    assert caught.value.__cause__ is error
    assert text_of(caught.value) == f"{type(error).__name__}: {error}".removesuffix(": ")
    assert is_raised(caught.value)
    assert isinstance(in_thread(partial(foreign, quit_with, error)), ContainedError)


def test_an_exception_passes_as_it_is() -> None:
    error = ValueError("no")
    with pytest.raises(ValueError, match="no") as caught:
        foreign(quit_with, error)
    assert caught.value is error


def test_an_interrupt_is_the_users_in_the_main_thread_alone() -> None:
    with pytest.raises(KeyboardInterrupt):
        foreign(quit_with, KeyboardInterrupt())
    assert isinstance(in_thread(partial(foreign, quit_with, KeyboardInterrupt())), ContainedError)


@pytest.fixture
def former() -> Iterator[None]:
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


def end(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    sys.exit(143)


@pytest.mark.usefixtures("former")
@pytest.mark.parametrize(
    "handler", [end, lambda number, frame: quit_with(Own(frame)), partial(end)]
)
def test_what_the_handler_of_a_signal_raises_passes_whatever_it_interrupts(handler: Any) -> None:
    signal.signal(signal.SIGTERM, handler)
    with pytest.raises((SystemExit, Own)):
        foreign(signal.raise_signal, signal.SIGTERM)


@pytest.mark.usefixtures("former")
def test_what_was_put_off_passes_at_the_end_of_the_block() -> None:
    def block() -> None:
        with Uninterrupted():
            signal.raise_signal(signal.SIGTERM)

    signal.signal(signal.SIGTERM, end)
    with pytest.raises(SystemExit):
        foreign(block)


def test_a_text_that_quits_is_none() -> None:
    class Quitting(Exception):  # noqa: N818 - as foreign code may call it
        def __str__(self) -> str:
            raise SystemExit(3)

    assert text_of(Quitting()) == "Quitting, whose text raised SystemExit"


def test_what_an_error_of_uoarm_says_has_no_traceback_of_uoarm_alone(
    caplog: pytest.LogCaptureFixture,
) -> None:
    log = LimitedLog("uoarm.test", burst=3)
    with pytest.raises(ConfigurationError) as caught:
        loads("version: 2")
    error, trace = caught.value, caught.value.__traceback__
    assert trace is not None
    log.write(logging.WARNING, "here is who called", error)
    log.write(logging.WARNING, "as caught within uoarm", error.with_traceback(trace.tb_next))
    plugin: dict[str, Any] = {"__name__": "uoarm_example._channels", "refused": error}
    exec("def call():\n    raise refused", plugin)
    with pytest.raises(ConfigurationError) as caught:
        plugin["call"]()
    trace = caught.value.__traceback__
    assert trace is not None
    log.write(logging.WARNING, "as raised by a plugin", error.with_traceback(trace.tb_next))
    first, *others = caplog.records
    assert first.exc_info is not None
    assert [record.exc_info for record in others] == [None, None]


def test_what_foreign_code_raises_is_written_within_bounds() -> None:
    """What a peer or a component raises may be endless: `LimitedLog` bounds text and number."""
    unbounded = re.compile(r"_log\.exception\(|exc_info=")
    root = Path(__file__).parents[1]
    core = [path for path in root.glob("src/**/*.py") if path.name != "_raised.py"]
    plugins = list(root.glob("plugins/*/src/**/*.py"))
    assert core
    assert plugins
    found = [
        path.name
        for path in (*core, *plugins)
        if unbounded.search(path.read_text(encoding="utf-8"))
    ]
    assert not found


@pytest.mark.parametrize("raised", [ArithmeticError(), SystemExit()], ids=repr)
def test_a_log_raises_nothing(raised: BaseException, monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken(logging.Handler):
        def emit(self, _: logging.LogRecord) -> None:
            raise raised

    log = Log("uoarm.test")
    monkeypatch.setattr(log.logger, "handlers", [Broken()])
    log.warning("%s", "text")
    log.log(logging.ERROR, "%s %s", "text", "another")


def test_a_record_is_of_the_place_that_writes_it(caplog: pytest.LogCaptureFixture) -> None:
    log = Log("uoarm.test")
    log.warning("text")
    log.log(logging.WARNING, "text")
    for logger in ("uoarm.test", log, log.logger):
        LimitedLog(logger).write(logging.WARNING, "text")
    places = {(record.filename, record.funcName) for record in caplog.records}
    assert len(caplog.records) == 5
    assert places == {("test_raised.py", "test_a_record_is_of_the_place_that_writes_it")}


def test_every_record_is_written_by_what_raises_nothing() -> None:
    """A handler that raises would keep what comes after a record from being done."""
    bare = re.compile(r"_log = logging\.getLogger\((?s:.*)_log\.(debug|info|warning|error|log)\(")
    root = Path(__file__).parents[1]
    paths = [*root.glob("src/**/*.py"), *root.glob("plugins/*/src/**/*.py")]
    assert len(paths) > 100
    assert not [path.name for path in paths if bare.search(path.read_text(encoding="utf-8"))]


@pytest.mark.parametrize("raised", [ValueError("no"), KeyboardInterrupt()], ids=repr)
def test_what_was_begun_is_undone_whatever_ends_the_block(raised: BaseException) -> None:
    undone: list[str] = []
    with pytest.raises(type(raised)) as caught, on_failure(undone.append, "first"):
        raise raised
    assert (caught.value, undone) == (raised, ["first"])


@pytest.mark.parametrize("raised", [ValueError("no"), KeyboardInterrupt()], ids=repr)
def test_an_undoing_that_fails_hides_not_what_ended_the_block(
    raised: BaseException, caplog: pytest.LogCaptureFixture
) -> None:
    def undo() -> None:
        raise SystemExit("the disk is full")

    with pytest.raises(type(raised)) as caught, on_failure(undo):
        raise raised
    assert caught.value is raised
    (record,) = caplog.records
    text = "what failed could not be undone: SystemExit: the disk is full"
    assert (record.levelname, record.message) == ("ERROR", text)


def test_an_interrupt_waits_until_what_was_begun_is_undone() -> None:
    undone: list[str] = []

    def undo() -> None:
        signal.raise_signal(signal.SIGINT)
        undone.append("whole")

    with pytest.raises(KeyboardInterrupt), on_failure(undo):
        raise ValueError("no")
    assert undone == ["whole"]


def test_what_was_begun_stays_where_the_block_ends_well() -> None:
    undone: list[str] = []

    def work() -> str:
        with on_failure(undone.append, "first"):
            return "done"

    assert (work(), undone) == ("done", [])
