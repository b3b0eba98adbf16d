"""What foreign code raised: contained, whose failure it is, its text, and a bounded log.

Components, bridges, plugins and callbacks may raise any `BaseException`, not only an `Exception`.
Past a thread's or a loop's `except Exception` that would end what serves others. So where foreign
code is called, it is called through `foreign`, or what it raised goes through `contained`. What
passes is only what interrupts the main thread for the user.
"""

from __future__ import annotations

import builtins
import logging
import os
import re
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partialmethod
from types import BuiltinFunctionType, FrameType, FunctionType, MethodType, TracebackType
from typing import Any, ParamSpec, TypeVar

from uoarm._encodable import encodable
from uoarm._interrupts import Uninterrupted
from uoarm.errors import BridgeError, FailureReason, UoarmError

P = ParamSpec("P")
T = TypeVar("T")

_LENGTH = 1000
_MOST_CHAINED, _MOST_WRITTEN = 50, 10_000
_GROUP: type[BaseException] | tuple[()] = getattr(builtins, "BaseExceptionGroup", ())
_OWN = frozenset({FailureReason.RAISED, FailureReason.BAD_MESSAGE, FailureReason.CONTRACT})
_RECORD_SECONDS = 10.0
_FUNCTIONS = {FunctionType, MethodType, BuiltinFunctionType}
_FOLDER = __file__.removesuffix("_raised.py")
_NUMBER = re.compile(r"\[Errno (-?\d+)\] ")
_NUMBER_AND_TEXT = re.compile(r"\(\d+, '([^']*)'\)")  # of termios, as pyserial hands it on
_LATE = re.compile(r"timed out|^$")
_OF_LOOP = re.compile(r"Connect call failed|error while attempting|Multiple exceptions")


class ContainedError(BridgeError):
    """Stands for what foreign code raised that is no `Exception`, which is its cause."""


def is_interrupt(error: BaseException) -> bool:
    """Say whether an exception interrupts the main thread for the user, so that it must pass.

    That is Ctrl-C, and whatever the handler of a signal raises there, as one of SIGTERM does. The
    same exception in another thread, or raised by foreign code itself, is a failure of that code.
    """
    if isinstance(error, Exception) or threading.get_ident() != threading.main_thread().ident:
        return False
    return isinstance(error, KeyboardInterrupt) or _is_of_signal(error.__traceback__)


def contained(error: BaseException) -> Exception:
    """Return what foreign code raised as an `Exception`, which is handled as any other.

    Raises:
        BaseException: it interrupts the main thread for the user.
    """
    if isinstance(error, Exception):
        return error
    if is_interrupt(error):
        raise error
    made = ContainedError(text_of(error))
    made.__cause__ = error
    return made


def foreign(call: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
    """Call foreign code.

    Raises:
        Exception: what it raised, or a ContainedError for what is none.
        BaseException: what interrupts the main thread for the user.
    """
    try:
        return call(*args, **kwargs)
    except Exception:
        raise
    except BaseException as error:
        raise contained(error) from error


def from_own_frames(error: BaseException) -> BaseException:
    """Have the traceback of an exception begin where foreign code does, and return it.

    The calls of uoarm that led there say nothing to who wrote that code. Where all is of uoarm and
    plugins, nothing is left out.
    """
    trace = error.__traceback__
    while trace is not None and _is_ours(trace.tb_frame):
        trace = trace.tb_next
    if trace is not None:
        error.__traceback__ = trace
    return error


def _is_ours(frame: FrameType) -> bool:
    """Say whether a frame is of uoarm, or of a plugin: those have names like uoarm's."""
    # Of uoarm by its file: modules of components are loaded under a name of uoarm's.
    name = frame.f_globals.get("__name__")
    is_plugin = type(name) is str and name.startswith("uoarm_")
    return is_plugin or frame.f_code.co_filename.startswith(_FOLDER)


def _is_of_signal(trace: TracebackType | None) -> bool:
    while trace is not None:
        if _is_handler(trace.tb_frame):
            return True
        trace = trace.tb_next
    return False


def _is_handler(frame: FrameType) -> bool:
    """Say whether a frame is that of a signal's handler.

    Python hands it the frame that it interrupts, which is the one that it returns to: no other
    call has that. Which handlers are installed says nothing: most put others in their place first.
    """
    interrupted = frame.f_back
    if interrupted is None:
        return False
    for value in frame.f_locals.values():
        given = value if type(value) is tuple else (value,)
        if any(part is interrupted for part in given):
            return True
    return False


def is_raised(error: BaseException) -> bool:
    """Say whether who raised this has failed, and not what it was given or the link to it.

    A MessageError is about the message, and a BridgeError for what is closed or not available is
    about the way there, of which its bridge reports.
    """
    if isinstance(error, BridgeError):
        return error.reason in _OWN
    return not isinstance(error, UoarmError)


def text_of(error: BaseException) -> str:
    """Return type and text of an error, or its type alone: a thousand characters at most.

    It can be written as UTF-8. Never raises, but for what interrupts the main thread.
    """
    if isinstance(error, ContainedError):
        return str(error)
    text = type(error).__name__
    try:
        said = foreign(str, error).strip()
        if said not in {"", text}:
            text += f": {said}"
    except Exception as other:  # noqa: BLE001 - foreign, as the error is
        raised = other.__cause__ if isinstance(other, ContainedError) else other
        text += f", whose text raised {type(raised).__name__}"
    return encodable(text[:_LENGTH])[:_LENGTH]


def writable(error: BaseException) -> BaseException:
    """Return an exception whose traceback may be written: this one, or what stands for it.

    In a traceback is the text of each exception that is chained to it or in its group, again for
    each group that it is in: a small one can fill the memory, and whatever waits for its record.
    """
    waiting, seen, left = [error], set[int](), _MOST_CHAINED
    while waiting:
        item = waiting.pop()
        left -= 1
        try:
            is_short = foreign(_written, item) <= _MOST_WRITTEN
        except Exception:  # noqa: BLE001 - foreign, as the error is
            is_short = False
        if not is_short or left < 0:
            made = ContainedError(text_of(error))
            made.__traceback__ = error.__traceback__
            return made
        for chained in (item.__cause__, item.__context__):
            if chained is not None and id(chained) not in seen:
                seen.add(id(chained))
                waiting.append(chained)
        if isinstance(item, _GROUP):
            waiting += item.exceptions[: _MOST_CHAINED + 1]  # type: ignore[attr-defined]  # 3.11
    return error


def _written(error: BaseException) -> int:
    return len(str(error)) + sum(map(len, getattr(error, "__notes__", ())))


def name_of(callback: Any) -> str:
    """Return the name of what others gave to be called: of an object that of its class.

    Nothing of its own is asked for it, which may raise.
    """
    kind = type(callback)
    name: str = callback.__qualname__ if kind in _FUNCTIONS else kind.__qualname__
    return name


def sentence_of(error: BaseException) -> str:
    """Return the text of an error of uoarm, which says all; of another one what `text_of` does."""
    return str(error) if isinstance(error, UoarmError) else text_of(error)


def reason_of(error: BaseException, path: object = None) -> str:
    """Return why something failed, in the system's words, without the name of a class.

    That is for errors of the operating system, of TLS, and for a `ValueError`, whose text is a
    sentence. Of any other error it is what `sentence_of` returns.

    Args:
        error: any.
        path: of a file that the text around this names already; other files of the error are named.
    """
    if isinstance(error, UoarmError):
        return str(error)
    if type(error).__name__ == "TimeoutError" and _LATE.search("".join(map(str, error.args))):
        return "no answer in time"  # of futures and loops, too, on CPython 3.10
    try:
        said = foreign(_reason, error)
    except Exception:  # noqa: BLE001 - foreign, as the error is
        said = ""
    if not said:
        return text_of(error)
    # Of two files, as of a link, the one that was to be made.
    named = getattr(error, "filename2", None) or getattr(error, "filename", None)
    if isinstance(named, str | bytes) and os.fsdecode(named) not in {"", str(path)}:
        said += f": {os.fsdecode(named)!r}"
    return encodable(said[:_LENGTH])[:_LENGTH]


def _reason(error: BaseException) -> str:
    if type(error) is ValueError or type(error).__module__ == "subprocess":
        return str(error)
    if not isinstance(error, OSError):
        return ""
    if type(error).__module__ == "ssl":
        named = getattr(error, "verify_message", "") or getattr(error, "reason", None)
        return str(named or error).rstrip(".").replace("_", " ").lower()
    said = error.strerror or str(error)
    if type(error).__name__ == "gaierror":
        import socket  # noqa: PLC0415 - for mistakes only

        unknown = {socket.EAI_NONAME, getattr(socket, "EAI_NODATA", socket.EAI_NONAME)}
        return "there is no host of this name" if error.errno in unknown else said
    if _OF_LOOP.match(said):  # which repeats the addresses, and may be about several
        numbers = [error.errno] if error.errno else map(int, _NUMBER.findall(said))
        return "; ".join(dict.fromkeys(map(os.strerror, numbers))) or said
    return _NUMBER_AND_TEXT.sub(r"\1", _NUMBER.sub("", said))


class on_failure:  # noqa: N801 - read as a block's beginning, as those of contextlib are
    """Undoes what was begun where its block does not end well, whatever ends it.

        with on_failure(self.close):
            self._wait()

    What ended the block is raised; what the undoing raises is logged. Ctrl-C and SIGTERM wait for
    the end of the undoing, a second one does not. It costs 0.3 us: what opens each part of a
    request does without it.

    Args:
        undo: called with the other arguments.
    """

    __slots__ = ("_args", "_kwargs", "_undo")

    def __init__(self, undo: Callable[P, object], /, *args: P.args, **kwargs: P.kwargs) -> None:
        self._undo, self._args, self._kwargs = undo, args, kwargs

    def __enter__(self) -> None:
        pass

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: object
    ) -> None:
        if kind is None:
            return
        try:
            with Uninterrupted():
                foreign(self._undo, *self._args, **self._kwargs)
        except Exception as raised:  # noqa: BLE001 - what ended the block says why
            text = f"what failed could not be undone: {text_of(raised)}"
            LimitedLog("uoarm").write(logging.ERROR, text, raised)


class Log:
    """Writes records to the logger of a name. It raises nothing: what comes after a record is done.

    Handlers are the application's, or a component's, and may raise anything.

    Args:
        name: of the logger.
    """

    def __init__(self, name: str) -> None:
        self.logger = logging.getLogger(name)

    def log(
        self, level: int, text: str, *values: object, exc_info: BaseException | None = None
    ) -> None:
        """Write a record, with the traceback of an exception."""
        with suppress(Exception):  # it is of the place that calls this, two frames above
            foreign(self.logger.log, level, text, *values, exc_info=exc_info, stacklevel=3)

    debug = partialmethod(log, logging.DEBUG)
    info = partialmethod(log, logging.INFO)
    warning = partialmethod(log, logging.WARNING)
    error = partialmethod(log, logging.ERROR)


class LimitedLog:
    """Writes the first of many like records, and then as many in ten seconds. Thread safe.

    It raises nothing: what is to be done after a record is done, too.

    A record says how many were left out since the one before it.

    Args:
        logger: where records go, or its name: many of these never write anything.
        burst: how many records in ten seconds.
        clock: seconds.
    """

    _lock = threading.Lock()  # one for all: there are thousands of these, and few write
    _room = 0
    _next: float | None = None
    _left_out = 0

    def __init__(
        self,
        logger: logging.Logger | Log | str,
        burst: int = 1,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._logger = logger
        self._burst = burst
        self._clock = clock

    def write(self, level: int, text: str, error: BaseException | None = None) -> None:
        """Write a record, with the traceback of an error, or count it as left out."""
        now = self._clock()
        with self._lock:
            if self._next is None or now >= self._next:
                self._next, self._room = now + _RECORD_SECONDS, self._burst
            if not self._room:
                self._left_out += 1
                return
            self._room -= 1
            left_out, self._left_out = self._left_out, 0
        more = f" (and {left_out} more since the last record)" if left_out else ""
        with suppress(Exception):  # of a handler of the application, or of a component
            foreign(self._log, level, f"{text}{more}", error)

    def _log(self, level: int, text: str, error: BaseException | None) -> None:
        logger = self._logger
        if isinstance(logger, str):
            logger = logging.getLogger(logger)
        elif isinstance(logger, Log):
            logger = logger.logger
        if isinstance(error, BridgeError) and error.__cause__ is not None:
            error = error.__cause__  # the text says already in which step that was raised
        shown = None if error is None else writable(from_own_frames(error))
        trace = None if error is None else error.__traceback__
        if isinstance(error, UoarmError) and trace is not None and _is_ours(trace.tb_frame):
            shown = None  # all of it is ours, and the text says more
        logger.log(level, "%s", text, exc_info=shown, stacklevel=4)
