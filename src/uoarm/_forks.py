"""What belongs to this process alone: a child that `os.fork` makes has a copy, not to be acted on.

In the child no thread of its parent runs, and locks may be held for ever by those that did. But its
descriptors are the parent's very sockets and pipes, the processes that it knows are the parent's
children, and what is registered with `atexit` runs in it, too. So whatever ends processes, says
something on a socket or removes files as it closes does so in the process that made it only.
"""

from __future__ import annotations

import atexit
import os
import signal
import threading
import weakref
from collections.abc import Callable, Collection, Iterable
from functools import partial
from typing import Any, Protocol


class _Closable(Protocol):
    def close(self) -> object: ...


_closable: weakref.WeakSet[_Closable] = weakref.WeakSet()
_handlers: dict[int, Any] = {}


class _Forking(threading.local):
    mask: Collection[int] = ()


class _Forks:
    """Counts the forks that led to this process.

    Attributes:
        generation: how many there were: what was made in another one is a parent's. Instead of the
            number of the process, which is a call of the system: a request asks many times.
    """

    generation = 0


_forking = _Forking()
forks = _Forks()


def at_exit(call: Callable[[], object]) -> Callable[[], None]:
    """Have something called when the interpreter of this process ends, as `atexit.register` does.

    A child that is forked does not call it. Returns what takes it back.
    """
    run = partial(_run_in, forks.generation, call)
    atexit.register(run)
    return partial(atexit.unregister, run)


def close_in_children(*descriptors: _Closable) -> None:
    """Have sockets or files closed in children as they are forked.

    Else a child would write into what its parent writes to, and the other end would not see the
    parent end as long as the child lives. Their `close` must take no lock. Kept weakly.
    """
    _closable.update(descriptors)


def default_in_children(numbers: Iterable[int]) -> None:
    """Have children that are forked treat these signals as if their handlers of now had never been.

    Such a handler wakes a thread or a loop, of which a child has none: it could not be terminated.
    """
    _handlers.update({number: signal.getsignal(number) for number in numbers})


def _run_in(generation: int, call: Callable[[], object]) -> None:
    if forks.generation == generation:
        call()


def _hold_signals() -> None:
    """Keep signals from a child until it treats them as it should; in the thread that forks."""
    _forking.mask = signal.pthread_sigmask(signal.SIG_BLOCK, tuple(_handlers))


def _let_signals_through() -> None:
    signal.pthread_sigmask(signal.SIG_SETMASK, _forking.mask)


def _forsake() -> None:
    forks.generation += 1
    for closable in tuple(_closable):
        closable.close()
    _closable.clear()
    for number, handler in _handlers.items():
        if signal.getsignal(number) == handler:  # no other has taken its place since
            signal.signal(number, signal.SIG_DFL)
    _handlers.clear()
    _let_signals_through()


os.register_at_fork(
    before=_hold_signals, after_in_parent=_let_signals_through, after_in_child=_forsake
)
