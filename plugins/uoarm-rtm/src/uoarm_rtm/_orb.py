# ruff: noqa: SLF001 - CORBA begins the names of its own operations with an underscore
"""The process's one ORB, the calls through it, and the border at which its exceptions become ours.

The ORB is shared by all bridges, begun with the first and destroyed with the last. One that the
application itself has begun is used as it is and left alone. It never ends under a call: omniORB
aborts the process when it is destroyed while a call is under way after a shutdown (`giopRope.cc`,
observed with 4.3.3), and when a thread comes back from a call while the interpreter ends.
"""

from __future__ import annotations

import os
import shutil
import socket
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import Any

import omniORB
from attrs import frozen
from omniORB import CORBA

from uoarm.bridge import Log, at_exit, close_in_children, on_failure
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm_rtm._compiler import omniorb_programs

# omniORB 4.3.3 reads here what `threading` has no more: who asks each thread of the process whether
# it lives would get an AttributeError.
if sys.version_info >= (3, 13):
    omniORB.WorkerThread.is_alive = threading.Thread.is_alive


class CallGuard:
    """A context manager around calls; entered from any thread, also nested."""

    def __init__(self) -> None:
        # Taken twice for each message, and as it is: a condition would double what that costs.
        self._lock = threading.Lock()
        self._changed = threading.Condition(self._lock)
        self._count = 0
        self._ended = False
        self._until = 0.0

    def __enter__(self) -> None:
        """Begin a call; raises CORBA.BAD_INV_ORDER when no call may begin any more."""
        with self._lock:
            if self._ended:
                raise CORBA.BAD_INV_ORDER(0, CORBA.COMPLETED_NO)
            self._count += 1

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End a call."""
        with self._lock:
            self._count -= 1
            if self._ended and not self._count:
                self._changed.notify_all()

    def end(self, seconds: float, cut: Callable[[], object] | None = None) -> bool:
        """Let no call begin any more, and wait for those under way.

        The time counts from the first time on: a port quiesces on its own when it is asked to
        disconnect, and again when the walk over all ports comes to it.

        Args:
            seconds: to wait.
            cut: ends connections of calls; called again while one is under way, which may just
                have made its own.

        Returns:
            whether all have come back in time.
        """
        with self._changed:
            now = time.monotonic()
            if not self._ended:
                self._until = now + seconds
            self._ended = True
        while cut is not None and self._count and time.monotonic() < self._until:
            cut()
            with self._changed:
                self._changed.wait_for(lambda: not self._count, _CUT_SECONDS)
        with self._changed:
            left = max(0.0, self._until - time.monotonic())
            return self._changed.wait_for(lambda: not self._count, left)

    @property
    def is_busy(self) -> bool:
        """Whether a call is under way."""
        return bool(self._count)

    def begin(self) -> None:
        """Let calls begin, with a new ORB."""
        with self._changed:
            self._ended = False


calls = CallGuard()
"""Of this process, as the ORB is: every call is among them."""
deliveries = CallGuard()
"""Of this process, too: calls of others that bring a message, while it is delivered."""


_CUT_SECONDS = 0.1
GONE = (CORBA.COMM_FAILURE, CORBA.TRANSIENT, CORBA.OBJECT_NOT_EXIST, CORBA.INV_OBJREF)
"""What a call raises whose peer, or the object there, is gone."""


@contextmanager
def corba_errors(what: str) -> Iterator[None]:
    """Turn CORBA's exceptions into a BridgeError that begins with what was being done.

    TIMEOUT becomes BridgeTimeoutError, a peer that is gone UNAVAILABLE, an answer or request
    that its stub does not understand REFUSED, anything else RAISED.
    """
    try:
        with calls:
            yield
    except CORBA.TIMEOUT as error:
        raise BridgeTimeoutError(f"{what}: no answer within the time limit") from error
    except GONE as error:
        text = f"{what}: the other side is gone ({corba_text(error)})"
        raise BridgeError(text, FailureReason.UNAVAILABLE) from error
    except (CORBA.MARSHAL, CORBA.BAD_PARAM, CORBA.BAD_OPERATION) as error:
        text = f"{what}: the two sides do not understand each other ({corba_text(error)})"
        raise BridgeError(text, FailureReason.REFUSED) from error
    except CORBA.Exception as error:
        raise BridgeError(f"{what}: {corba_text(error)}", FailureReason.RAISED) from error


def corba_text(error: CORBA.Exception) -> str:
    """Return the name of a CORBA exception, with its minor code where that has a name."""
    text = type(error).__name__
    if isinstance(error, CORBA.SystemException):
        name = str(getattr(error, "_NP_RepositoryId", text)).split("/")[-1].split(":")[0]
        return f"{name}, {error.minor}" if error.minor else name
    return text


MOST_CONNECTIONS = 256
"""From this process to one server at once; they are opened as they are needed."""
_MOST_OCTETS = 1 << 26
_IDLE_SECONDS = "10"
_DRAIN_SECONDS = 4.0
_DESTROY_SECONDS = 5.0
_WORKERS_SECONDS = 1.0
_LOOK_SECONDS = 0.001

_log = Log("uoarm.rtm")


class _OrbShutdown:
    """Ends an ORB on request, in a thread of its own, since that may hang.

    The thread begins before the ORB: none can begin while the process exits.
    """

    def __init__(self) -> None:
        self.orb: Any = None
        self._begun = threading.Event()
        self._thread = threading.Thread(target=self._run, name="uoarm-rtm-end", daemon=True)
        self._thread.start()

    def begin(self) -> None:
        """End the ORB; it waits for calls under way, which have their limits."""
        self._begun.set()

    def join(self) -> bool:
        """Wait until it has ended, at most 5 s; returns whether it has."""
        self._thread.join(_DESTROY_SECONDS)
        return not self._thread.is_alive()

    def _run(self) -> None:
        self._begun.wait()
        if self.orb is None:  # it could not begin
            return
        if not calls.end(_DRAIN_SECONDS, lambda: _cut(_shared.called)):
            _log.warning("a CORBA call does not come back: the ORB is left as it is")
            return
        try:
            # An ORB that the application has shut down cannot be destroyed safely: calls made
            # since then may have opened connections, at which omniORB aborts the process.
            self.orb.work_pending()
            self.orb.destroy()
        except CORBA.Exception:
            _log.warning("the ORB of this process was shut down from outside: it is left so")
            return
        _wait_for_workers()


@frozen
class _RunningOrb:
    """The ORB of the process; `ending` is None for one that the application has begun."""

    orb: Any
    address: str
    most_octets: int
    ending: _OrbShutdown | None


class _Shared:
    """Counts the users of the ORB."""

    def __init__(self) -> None:
        # Guards all fields: bridges begin and end in any thread, and two ORBs must never overlap.
        self.lock = threading.Lock()
        self.users = 0
        self.running: _RunningOrb | None = None
        self.destroying: _OrbShutdown | None = None
        # Where calls went that may last, as the kernel writes an IPv4 address and a port.
        self.called: set[str] = set()


_shared = _Shared()


class _ServedSockets:
    """What the ORB listens at, and the connections that others have made there.

    omniORB knows no forks: where a child held these, a component that sends to the dead parent
    would wait for ever. Found on Linux only.
    """

    def __init__(self, port: int) -> None:
        self._port = port

    def close(self) -> None:
        """Close them, in a child."""
        # What gets such a limit as it is looked at becomes non-blocking for the parent, too.
        limit = socket.getdefaulttimeout()
        socket.setdefaulttimeout(None)
        for number in [int(path.name) for path in Path("/proc/self/fd").glob("*")]:
            with suppress(OSError):  # it is no socket
                held = socket.socket(fileno=number)
                local = held.getsockname()
                if isinstance(local, tuple) and local[1] == self._port:
                    held.close()
                held.detach()
        socket.setdefaulttimeout(limit)


def _cut(called: set[str]) -> None:
    """Shut this process's connections to these addresses down, as omniORB ends no call by itself.

    Found on Linux only, in the kernel's table: `socket` may change what it looks at.
    """
    with suppress(OSError):
        rows = [row.split() for row in Path("/proc/self/net/tcp").read_text().splitlines()[1:]]
        inodes = {f"socket:[{row[9]}]" for row in rows if row[2] in called}
        for path in Path("/proc/self/fd").glob("*"):
            with suppress(OSError):  # it was closed meanwhile
                if str(path.readlink()) in inodes:
                    _shut_down(int(path.name), inodes)


def _shut_down(number: int, inodes: set[str]) -> None:
    copy = os.dup(number)  # the number itself may be another socket's by now
    if str(Path(f"/proc/self/fd/{copy}").readlink()) not in inodes:
        os.close(copy)
        return
    with socket.socket(fileno=copy) as held:
        held.shutdown(socket.SHUT_RDWR)


def _address_of(reference: str) -> tuple[str, int]:
    """Return host and port in a stringified reference (CORBA 3.3, part 2, 7.6 and 9.7.2)."""
    octets = bytes.fromhex(reference.removeprefix("IOR:"))
    # In it: the type, how many profiles, then the first: tag, length, and what is a whole again.
    at = 8 + _unpack("I", octets, 4)
    profile = octets[at + -at % 4 + 12 :]
    at = 8 + _unpack("I", profile, 4)  # behind the host
    return profile[8 : at - 1].decode(), _unpack("H", profile, at + at % 2)


def _unpack(form: str, octets: bytes, at: int) -> int:
    """Return a number of an encapsulation, whose first octet says in which order its octets are."""
    number: int = struct.unpack_from(("<" if octets[0] else ">") + form, octets, at)[0]
    return number


class Orb:
    """One user's hold on the ORB, with a POA of its own for servants.

    Args:
        address: interface that servants listen on.
        call_seconds: limit of every call that has no limit of its own.
        most_octets: limit of one message of GIOP, sent or received.

    Raises:
        BridgeError: REFUSED when an ORB is running that listens elsewhere, or has another limit;
            RAISED when omniORB cannot begin.
    """

    def __init__(self, address: str, call_seconds: float, most_octets: int = _MOST_OCTETS) -> None:
        self.most_octets = most_octets
        with _shared.lock:
            self._orb = _begin(address, call_seconds, most_octets)
            _shared.users += 1
        self._closed = False
        try:
            with corba_errors("starting the ORB (unless it was shut down in this process before)"):
                root = self._orb.resolve_initial_references("RootPOA")
                root._get_the_POAManager().activate()
                self._poa = root.create_POA(f"uoarm-{id(self)}", None, [])
                self._poa._get_the_POAManager().activate()
                nothing = self._poa.create_reference("IDL:omg.org/CORBA/Object:1.0")
                self._served = _ServedSockets(_address_of(self._orb.object_to_string(nothing))[1])
                close_in_children(self._served)
        except BridgeError:
            with _shared.lock:
                _shared.users -= 1
            raise

    def serve(self, servant: Any) -> Any:
        """Make a servant reachable and return its reference."""
        with corba_errors("serving an object"):
            return self._poa.id_to_reference(self._poa.activate_object(servant))

    def withdraw(self, reference: Any) -> None:
        """Make a servant unreachable; does not wait for calls under way, and may come twice."""
        with suppress(CORBA.Exception), calls:  # withdrawn before, or everything has ended
            self._poa.deactivate_object(self._poa.reference_to_id(reference))

    def text(self, reference: Any) -> str:
        """Return the stringified reference (IOR)."""
        with corba_errors("writing a reference"):
            return str(self._orb.object_to_string(reference))

    def reference(self, text: str) -> Any:
        """Return the object of a stringified reference or corbaloc address.

        Raises:
            BridgeError: it cannot be read.
        """
        with corba_errors(f"reading the reference {text[:60]!r}"):
            return self._orb.string_to_object(text)

    def called(self, text: str) -> None:
        """Note where calls through a reference go: as the ORB ends, those under way end, too."""
        with suppress(OSError, ValueError, struct.error):  # no IPv4 address, or another profile
            host, port = _address_of(text)
            octets = int.from_bytes(socket.inet_aton(host), sys.byteorder)
            _shared.called.add(f"{octets:08X}:{port:04X}")

    def close(self) -> None:
        """Let go; the last user's call ends the ORB and waits at most 5 s for it.

        Calls under way end with the ORB; another bridge's may share a connection, so before that
        they go on to their limits, for no caller.
        It does not wait where a message is still being delivered, which the end of the ORB does.
        """
        with _shared.lock:
            if self._closed:
                return
            self._closed = True
            _shared.users -= 1
            ending = _end() if _shared.users == 0 else None
        if ending is not None:
            # Channels are closed by now: a delivery that has not ended began before, and may have
            # asked for this. The next ORB waits for this one to end.
            if not deliveries.is_busy:
                ending.join()
        else:
            destroying = threading.Thread(
                target=_destroy_poa, args=(self._poa,), name="uoarm-rtm-poa", daemon=True
            )
            try:
                destroying.start()
            except RuntimeError:  # the system gives no more threads
                _destroy_poa(self._poa)


def limit(reference: Any, seconds: float) -> Any:
    """Set the time limit of all calls through this reference, and return it."""
    omniORB.setClientCallTimeout(reference, max(1, int(seconds * 1000)))
    return reference


def narrowed(reference: Any, interface: Any, seconds: float, what: str) -> Any:
    """Return a reference as an interface, with a time limit on its calls.

    Raises:
        BridgeError: the peer is gone, hangs, or is something else.
    """
    with corba_errors(what):
        if reference is None:
            raise BridgeError(f"{what}: the reference is nil", FailureReason.UNAVAILABLE)
        narrow = limit(reference, seconds)._narrow(interface)
        if narrow is None:
            kind = str(interface._NP_RepositoryId)
            raise BridgeError(f"{what}: it is not a {kind}", FailureReason.REFUSED)
        return limit(narrow, seconds)


def _begin(address: str, call_seconds: float, most_octets: int) -> Any:
    if _shared.running is None:
        if _shared.destroying is not None and not _shared.destroying.join():
            text = (
                "the ORB of this process cannot begin again: the last one has not ended, since a "
                "consumer of an OutPort's message does not return; try again when it has"
            )
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        calls.begin()
        _shared.called.clear()
        foreign = omniORB.orb is not None
        arguments = {
            # No limit for connecting of its own: the first call through a new connection would have
            # at least that, whatever its reference's limit (observed). Calls include connecting.
            "clientCallTimeOutPeriod": str(int(call_seconds * 1000)),
            # Each call under way has a connection. With five, as usual, a component that is busy
            # with as many calls would seem to hang, since a check would wait for one of these.
            "maxGIOPConnectionPerServer": str(MOST_CONNECTIONS),
            "supportPerThreadTimeOut": "1",
            "endPoint": f"giop:tcp:{address}:",
            "giopMaxMsgSize": str(most_octets),
            # What is idle is closed by the side that opened it: ours after ten seconds, since each
            # has a thread; a peer's after its own limit, by default 120 s. Where a server closes,
            # the client's next call fails if calls there have a time limit, and a component that
            # had paused drops its port's connection. Ours, as a server, stays at omniORB's 180 s.
            "outConScanPeriod": _IDLE_SECONDS,
            "traceLevel": "0",
        }
        words = ["uoarm"]
        for name, value in arguments.items():
            words += [f"-ORB{name}", value]
        ending = _OrbShutdown()
        with on_failure(ending.begin), corba_errors(f"starting the ORB on {address}"):
            orb = CORBA.ORB_init(words, CORBA.ORB_ID)
        if foreign:
            ending.begin()
        else:
            ending.orb = orb
        _shared.running = _RunningOrb(orb, address, most_octets, None if foreign else ending)
        _shared.users = 0
    elif _shared.running.address != address and _shared.running.ending is not None:
        text = (
            f"the ORB of this process listens on {_shared.running.address}, not on {address}: "
            "give all bridges of the process one address, or this one a bridge host"
        )
        raise BridgeError(text, FailureReason.REFUSED)
    elif _shared.running.most_octets != most_octets and _shared.running.ending is not None:
        text = (
            f"the ORB of this process takes messages of {_shared.running.most_octets} octets, not "
            f"of {most_octets}: give all bridges of the process one `max_message`"
        )
        raise BridgeError(text, FailureReason.REFUSED)
    return _shared.running.orb


def _end() -> _OrbShutdown | None:
    """Begin to end the ORB, unless it is the application's own; with the lock held."""
    running = _shared.running
    if running is None or running.ending is None:
        return None
    running.ending.begin()
    _shared.running, _shared.destroying = None, running.ending
    return running.ending


def _end_at_exit() -> None:
    """End an ORB that is left when the process exits, and the calls through one left alone.

    No thread may be on its way from C++ into Python when the interpreter ends: that aborts the
    process ("terminate called without an active exception").
    """
    with _shared.lock:
        running = _shared.running
        _end()
        ending = _shared.destroying
    if ending is not None:
        ending.join()
    if running is not None and running.ending is None:
        calls.end(_DRAIN_SECONDS)


at_exit(_end_at_exit)


def _wait_for_workers() -> None:
    """Wait until the threads in which omniORB served calls are gone, which `destroy` does not.

    Each goes into Python once more to take itself off the list of threads.
    """
    deadline = time.monotonic() + _WORKERS_SECONDS
    while time.monotonic() < deadline:
        if not any(isinstance(thread, omniORB.WorkerThread) for thread in threading.enumerate()):
            return
        time.sleep(_LOOK_SECONDS)


def _destroy_poa(poa: Any) -> None:
    with suppress(CORBA.Exception), calls:
        poa.destroy(True, False)  # etherealise, do not wait


def environment() -> dict[str, str]:
    """Return the version of omniORB, where its programs are, and variables of the environment."""
    programs = omniorb_programs()
    naming = (programs / "omniNames") if programs is not None else shutil.which("omniNames")
    facts = {
        "omniORBpy": str(omniORB.coreVersion()),
        "omniNames": str(naming or "missing"),
    }
    for name in ("OMNIORB_CONFIG", "ORBendPoint"):
        if name in os.environ:
            facts[name] = os.environ[name]
    return facts
