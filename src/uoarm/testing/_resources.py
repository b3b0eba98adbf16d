"""What a test holds of the machine: threads, file descriptors, processor time and ports."""

from __future__ import annotations

import gc
import os
import socket
import threading
import time
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from random import SystemRandom

from uoarm._arguments import arguments
from uoarm._support.workers import PoolThread
from uoarm.testing._waiting import crowd, patience, slowness, wait

_DESCRIPTORS = ("/proc/self/fd", "/dev/fd")
_OF_THE_CORE = "uoarm-step"
_GLANCE_SECONDS = 0.01
_LOOK_SECONDS = 0.5
_IDLE_SHARE = 0.05
_MOST_IDLE_SHARE = 0.15
_WAKES_PER_SECOND = 100
_MOST_WAKING_SHARE = 0.2
_LOOKS_BEFORE_CREDIT = 3
_MOST_WANTED_SHARE = 0.5


def hold_idle(moment: str, *others: int, timeout: float | None = None) -> None:
    """Hold that this process takes hardly any processor time: 5 % of one processor.

    What waits takes next to none, but a heartbeat costs more on a slower machine, and where others
    take the processor's caches: it may take as much more as that is slower (`slowness`), or as
    others want each core at the moment, 15 % at most. A loop that turns for nothing takes all that
    it gets, which is more also there. One look that finds none is enough.

    Args:
        moment: when that is, for the failure.
        others: ids of processes that are counted, too, where the system lists them: Linux.
        timeout: seconds in which it is looked again; `patience`, unless given.

    Raises:
        AssertionError: it takes more, at each look.
    """
    shares: list[float] = []
    wakes: list[float] = []

    def is_idle() -> bool:
        wanted = _wanted_seconds(others)
        begin, before = time.monotonic(), _processor_seconds(others)
        own = time.thread_time()
        threading.Event().wait(_LOOK_SECONDS)
        wakes.append(time.thread_time() - own)
        used = _processor_seconds(others) - before
        seconds = time.monotonic() - begin
        shares.append(used / seconds)
        if shares[-1] >= idle_share(max(slowness(), crowd()), wakes):
            return False
        now = _wanted_seconds(others)
        most = max((now[thread] - wanted[thread] for thread in wanted.keys() & now), default=0.0)
        shares[-1] = max(shares[-1], most / seconds)
        return most < _MOST_WANTED_SHARE * seconds

    try:
        wait(is_idle, timeout=timeout)
    except AssertionError:
        least = f"{min(shares):.0%} of a processor"
        text = f"a loop turns for nothing {moment}: {least} at least, in {len(shares)} looks"
        raise AssertionError(text) from None


def idle_share(slower: float, wakes: Sequence[float]) -> float:
    """Return the share of a processor below which it counts as idle.

    Args:
        slower: how many times slower than usual what waits has its work done.
        wakes: processor seconds that a thread took in each look for one wake-up. The least of
            them counts, and only when there are three: a single one may have been disturbed.
    """
    waking = _WAKES_PER_SECOND * min(wakes) if len(wakes) >= _LOOKS_BEFORE_CREDIT else 0.0
    return min(_IDLE_SHARE * slower, _MOST_IDLE_SHARE) + min(waking, _MOST_WAKING_SHARE)


class ResourceSnapshot:
    """The threads and descriptors at one moment, to be compared with a later one.

    The core's own step threads do not count, nor do others of its pools that are idle: they end by
    themselves. Nor does one that took the place of another of its name, which has ended. Nor do
    threads that a library started without Python, which call into it: Python does not know when
    they end.
    """

    def __init__(self) -> None:
        gc.collect()
        self._threads = set(threading.enumerate())
        self._descriptors = _open_descriptors()

    def check(self, timeout: float | None = None) -> None:
        """Hold that nothing is left over, giving threads and descriptors time to end.

        Without a timeout they have the time of `patience`.

        Raises:
            AssertionError: it names the threads that stay, or the descriptors that are new.
        """
        deadline = time.monotonic() + (patience() if timeout is None else timeout)
        pause = threading.Event()
        # Not joined: one of them may be about to begin, which Python refuses to join.
        while names := sorted(thread.name for thread in self._left_over()):
            if time.monotonic() >= deadline:
                raise AssertionError(f"{len(names)} threads are left over: {', '.join(names[:8])}")
            pause.wait(_GLANCE_SECONDS)
            gc.collect()  # a pool's threads end with the last reference to it
        if len(_open_descriptors()) > len(self._descriptors):
            gc.collect()  # what holds them may be a circle
        while (extra := len(now := _open_descriptors()) - len(self._descriptors)) > 0:
            if time.monotonic() >= deadline:
                new = sorted(set(now.items()) - set(self._descriptors.items()))
                targets = ", ".join(f"{number} is {target}" for number, target in new[:8])
                raise AssertionError(f"{extra} file descriptors are left over: {targets}")
            pause.wait(_GLANCE_SECONDS)

    def _left_over(self) -> list[threading.Thread]:
        new = [
            thread
            for thread in threading.enumerate()
            if thread not in self._threads
            and thread.name != _OF_THE_CORE
            and not isinstance(thread, threading._DummyThread)  # noqa: SLF001 - these are never joined
            and not (isinstance(thread, PoolThread) and thread.is_idle)
        ]
        replaced = Counter(thread.name for thread in self._threads if not thread.is_alive())
        replaced &= Counter(thread.name for thread in new)
        for thread in tuple(new):
            if replaced[thread.name]:
                replaced[thread.name] -= 1
                new.remove(thread)
        return new


def _processor_seconds(others: tuple[int, ...]) -> float:
    seconds = time.process_time()
    for process in others:
        with suppress(OSError):
            text = Path(f"/proc/{process}/stat").read_text(encoding="utf-8")
            user, system = text.rpartition(")")[2].split()[11:13]  # its name may have blanks
            seconds += (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
    return seconds


def _wanted_seconds(others: tuple[int, ...]) -> dict[Path, float]:
    """Return how long each thread has run, or waited for a processor; none where none is said."""
    wanted = {}
    for process in (os.getpid(), *others):
        for thread in Path(f"/proc/{process}/task").glob("*"):
            with suppress(OSError):  # it has ended, or this is not Linux
                run, waited = (thread / "schedstat").read_text(encoding="utf-8").split()[:2]
                wanted[thread] = (int(run) + int(waited)) / 1e9
    return wanted


def _open_descriptors() -> dict[int, str]:
    """Return what each open descriptor is, by number; none where the system does not say."""
    for folder in map(Path, _DESCRIPTORS):
        try:
            numbers = [int(entry.name) for entry in folder.iterdir()]
        except OSError:
            continue
        return {number: _target(folder / str(number)) for number in numbers}
    return {}


def _target(descriptor: Path) -> str:
    try:
        return str(descriptor.readlink())
    except OSError:  # that of the listing itself, or the system has no links here
        return "not known"


_GIVEN = Path("/proc/sys/net/ipv4/ip_local_port_range")
_LOWEST = 10_000
_TRIES = 100


@arguments()
def free_port(address: str = "127.0.0.1") -> int:
    """Return a TCP port that is free, and that the system gives only to a process that asks for it.

    One that the system chose itself may be given to the next connection of any process before a
    server listens on it, or while one is restarted.

    Args:
        address: interface on which it is free.

    Raises:
        OSError: none of a hundred ports is free.
    """
    first_given = 32768
    with suppress(OSError):
        first_given = int(_GIVEN.read_text().split()[0])
    for port in SystemRandom().sample(range(_LOWEST, max(first_given, 2 * _LOWEST)), _TRIES):
        with socket.socket() as one, suppress(OSError):
            one.bind((address, port))
            return port
    raise OSError(f"none of {_TRIES} ports of {address} is free")
