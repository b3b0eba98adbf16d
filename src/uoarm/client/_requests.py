"""What a client asks a server that opens no stream, and what it answers: shape and meaning.

A server may be of another version, something else, or hostile. So nothing of an answer is relied
on that is not described here; what else it has is let through.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, TypeAlias

from uoarm import errors
from uoarm._arguments import arguments
from uoarm._interrupts import wait_step

_TYPES: Mapping[str, Callable[[Any], bool]] = {
    "any": lambda value: value is not _MISSING,
    "null": lambda value: value is None,
    "text": lambda value: isinstance(value, str),
    "boolean": lambda value: isinstance(value, bool),
    "integer": lambda value: type(value) is int and abs(value) < _BEYOND,
    "number": lambda value: type(value) is float or _TYPES["integer"](value),
    "time": lambda value: _TYPES["number"](value) and 0 <= value < _LAST_TIME,
    "object": lambda value: isinstance(value, dict),
    "list": lambda value: isinstance(value, list),
    "pairs": lambda value: isinstance(value, list) and all(map(_is_pair, value)),
}
# The name of a type, or of several with `|` between; the shape of each item of a list; or of each
# field of an object, with `?` behind the name of one that may be missing, and `*` for all names. In
# a tuple: what may be null, too.
Shape: TypeAlias = "str | list[Any] | tuple[Any] | Mapping[str, Any]"
_BEYOND = 2**63  # more is counted nowhere, and has no form as a float in the end
_LAST_TIME = 2.5e11  # seconds since the epoch, of the last date that has a form
_CELL = "text|boolean|number|null"
_PAIR = 2
_MISSING: Any = object()
_SHOWN = 60


def _is_pair(value: object) -> bool:
    return isinstance(value, list) and len(value) == _PAIR


def checked(value: Any, shape: Shape, what: str) -> Any:
    """Return a value that has a shape.

    Raises:
        ControlMessageError: it has not; the text names the field.
    """
    if (mistake := _mistake(value, shape)) is not None:
        path, text = mistake
        place = ".".join(name[:_SHOWN] for name in reversed(path))
        raise errors.ControlMessageError(": ".join(filter(None, (what, place, text))))
    return value


def _mistake(value: Any, shape: Shape) -> tuple[list[str], str] | None:
    """Return what is wrong, and where: the path from the inside to the outside."""
    if isinstance(shape, str):
        if any(_TYPES[name](value) for name in shape.split("|")):
            return None
        found = "nothing" if value is _MISSING else type(value).__name__
        return [], f"expected {shape.replace('|', ' or ')}, got {found}"
    if isinstance(shape, tuple):
        return None if value is None else _mistake(value, shape[0])
    if not isinstance(value, list if isinstance(shape, list) else dict):
        return _mistake(value, "list" if isinstance(shape, list) else "object")
    for name, item, inner in _items(value, shape):
        if (mistake := _mistake(item, inner)) is not None:
            mistake[0].append(name)
            return mistake
    return None


def _items(value: Any, shape: list[Any] | Mapping[str, Any]) -> Iterator[tuple[str, Any, Shape]]:
    if isinstance(shape, list):
        return ((str(index), item, shape[0]) for index, item in enumerate(value))
    if "*" in shape:
        return ((str(name), item, shape["*"]) for name, item in value.items())
    return (
        (name, value.get(name, _MISSING), inner)
        for field, inner in shape.items()
        if (name := field.rstrip("?")) in value or name == field
    )


_EVENT: Mapping[str, Shape] = {
    "number": "integer", "time": "number", "subject": "text", "change": "text", "cause": "text",
    "function": "text", "error_code?": "text",
}  # fmt: skip
NOTICES: Mapping[str, Shape] = {
    "hello": {"message_bytes?": "integer|null", "time?": "number", "manager?": "text"},
    "connection": {"connection": "text", "state": "text", "cause": "text", "number": "integer"},
    "change": _EVENT,
}
"""What comes without a question, by its `type`."""
_ERROR: Shape = {"code": "text", "text": "text", "error_code?": "text"}
KEPT: Shape = {"key": "text", "seconds": "number"}
RESUMED: Shape = {"own": [{"connection": "text", "number": "integer|null"}]}

_NUMBER = "number|null"
_COMMAND: Shape = {
    "phase": "text", "since": _NUMBER, "left": _NUMBER, "dropped": "pairs", "cause": "text",
}  # fmt: skip
_LEASE: Shape = {"holder": ({"id": "text", "role": "text"},), "left": _NUMBER}
_LIMIT: Shape = {"path": "text", "minimum": _NUMBER, "maximum": _NUMBER, "rate": _NUMBER}
_ENTRIES: Mapping[str, Shape] = {
    "components": {
        "name": "text", "health": "text", "cause": "text", "last_error": "text",
        "function?": _CELL, "failed?": _CELL, "lost?": _CELL,
        "channels?": [{
            "port": "text", "facts": "pairs", "command?": (_COMMAND,), "lifetime?": _NUMBER,
            "lease?": (_LEASE,), "limits?": [_LIMIT],
        }],
    },
    "connections": {
        "id": "text", "components": ["text"], "state": "text", "cause": "text",
        "function?": _CELL, "lost?": _CELL,
    },
    "routes": {
        "producer": "text", "consumer": "text", "age": _NUMBER, "refusal?": "text",
        "received?": _CELL, "delivered?": _CELL, "rate?": _CELL, "dropped?": "pairs",
    },
}  # fmt: skip
_GONE: Mapping[str, Shape] = {"components": "text", "connections": "text", "routes": ["text"]}
_STATUS: Mapping[str, Shape] = {
    "version?": "integer", "time?": "number", "held?": _NUMBER,
    "own?": [{"connection": "text", "number": "integer|null"}],
    "past?": [{**_EVENT, "age": "number"}],
    "bridges?": [{
        "name": "text", "plugin?": _CELL, "health?": _CELL, "process?": _CELL, "cause?": _CELL,
        "assigned?": "pairs", "facts?": "pairs",
    }],
    "machines?": [{
        "name": "text", "present?": _CELL, "clock_offset?": _CELL, "clock_error?": _CELL,
        "cause?": _CELL,
    }],
    "offers?": [{
        "name": "text", "state?": _CELL, "calls?": _CELL, "failed?": _CELL, "cause?": _CELL,
    }],
    "lock?": [{
        "component": "text", "port?": _CELL, "refused?": _CELL, "times?": _CELL, "cause?": _CELL,
    }],
    "clients?": ["object"],
}  # fmt: skip
_STRUCTURES: Shape = {"*": {"schema": "object|boolean"}}
_CHANGE: Shape = {
    "revision": "integer", "differences": ["text"], "connections": "list", "is_applied": "boolean",
    "is_kept": "boolean", "time": "time", "text": "text",
}  # fmt: skip
_APPROVAL: Shape = {
    "approval": "text", "phase": "text", "requester": "text", "operation": "text",
    "function": "text", "port": "text", "arguments": "any", "digest": "text",
    "envelope": {"ranges": "any", "count": "number", "rate": "any"},
    "components": ["text"], "revision": "integer", "preview": "text", "left": _NUMBER,
}  # fmt: skip
_RECORDING: Shape = {"recording": "text", "state": "text", "files": ["text"]}
_PLAYER: Shape = {"bridge": "text", "functions": ["text"], "may_move": "boolean", "cause": "text"}
_ANSWERS: Mapping[str, Shape] = {
    "Request": {
        "connection": "text", "inputs": ["text"], "output?": "text|null", "warnings": ["text"],
        "lifetimes?": {"*": "number"}, "latched?": "boolean", "number?": "integer|null",
    },
    "List": {
        "functions": [{
            "name": "text", "description": "text", "service": "boolean", "outputs": ["text"],
            "inputs": ["text"],
            "components": [{"name": "text", "bridge": "text", "priority": "integer"}],
        }],
    },
    "Resolve": {
        "plan": {"steps": [{"component": {"name": "text"}, "structures": _STRUCTURES}]},
        "text": "text",
    },
    "Configure": {"revisions": [_CHANGE]},
    "Configure text": _CHANGE,
    "Configure rollback": _CHANGE,
    "Configure schema": {"schema": "object"},
    "Discover": {"bridges": ["object"]},
    "Discover take": {"text": "text"},
    "Approve": {"approvals": [_APPROVAL]},
    "Approve type": _APPROVAL,
    "Record": {"recordings": [_RECORDING]},
    "Record functions": _RECORDING,
    "Record type": _RECORDING,
    "Play": {"players": [_PLAYER]},
    "Play type": _PLAYER,
    "Stop type": "any",
    "Stop release": "any",
    "Stop": {
        "stopped": "boolean", "text": "text",
        "inputs": [{
            "function": "text", "component": "text", "port": "text", "stopped": "boolean",
            "since": _NUMBER, "cause": "text",
        }],
    },
}  # fmt: skip
"""By the question: its op, and what it has that makes it another one."""


def checked_answer(asked: Mapping[str, Any], answer: Any) -> Any:
    """Return what answers a question, where it is what the protocol says; raises as `checked`."""
    op = asked["op"]
    if op == "Status":
        return checked(answer, _status_shape(answer), "the server's Status")
    if op not in _ANSWERS:  # whatever a service replies, and nothing
        return answer
    more, names = asked.get("jsonMessage"), ["type"] if asked.get("type") else []
    names += more if isinstance(more, Mapping) else ()
    kinds = (kind for name in names if (kind := f"{op} {name}") in _ANSWERS)
    return checked(answer, _ANSWERS[next(kinds, op)], f"the server's Reply to {op}")


def _status_shape(answer: Any) -> Shape:
    shape = dict(_STATUS)
    is_partial = isinstance(answer, dict) and "since" in answer
    for part, entry in _ENTRIES.items():
        is_change = is_partial and isinstance(answer.get(part), dict)
        change = {"changed?": [entry], "gone?": [_GONE[part]]}
        shape[f"{part}?"] = change if is_change else [entry]
    return {**shape, "elapsed": "number"} if is_partial else shape


_ERRORS: Mapping[str, Callable[[str], errors.UoarmError]] = {
    "configuration": errors.ConfigurationError,
    "resolution": errors.ResolutionError,
    "bridge": errors.BridgeError,
    "timeout": errors.BridgeTimeoutError,
    "message": errors.MessageError,
    "held": partial(errors.CommandRefusedError, reason="held"),
    "leased": partial(errors.CommandRefusedError, reason="leased"),
    "refused": partial(errors.CommandRefusedError, reason="stopped"),
    "usage": errors.UsageError,
    "closed": errors.ConnectionClosedError,
    "unknown": errors.ConnectionClosedError,
}


class ServerError(errors.UoarmError):
    """The server refused; `code` is that of the protocol: denied, limit, busy, internal."""

    def __init__(self, code: str, text: str) -> None:
        super().__init__(text)
        self.code = code


def error_of(message: Any) -> errors.UoarmError:
    """Return what an Error of the server says, as the exception that is raised for it.

    Raises:
        ControlMessageError: it says nothing.
    """
    checked(message, _ERROR, "Error")
    code, text = message["code"], message["text"]
    kind = _ERRORS.get(code)
    error = ServerError(code, text) if kind is None else kind(text)
    error.error_code = message.get("error_code", error.error_code)
    return error


_KEYS: Mapping[str, Callable[[Mapping[str, Any]], Any]] = {
    "components": lambda entry: entry["name"],
    "connections": lambda entry: entry["id"],
    "routes": lambda entry: (entry["producer"], entry["consumer"]),
}


def merged_status(known: Mapping[str, Any], received: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the whole status map, of the one that is known and the changes since then."""
    if "since" not in received:
        return received
    elapsed = received["elapsed"]
    merged = {**known, **received}
    del merged["since"], merged["elapsed"]
    for part, key_of in _KEYS.items():
        change = received.get(part, {})
        if isinstance(change, list):
            continue
        entries = {key_of(entry): entry for entry in known.get(part, ())}
        if part == "routes":
            for key, route in entries.items():
                if route["age"] is not None:
                    entries[key] = {**route, "age": route["age"] + elapsed}
        for key in change.get("gone", ()):
            entries.pop(tuple(key) if isinstance(key, list) else key, None)
        entries.update((key_of(entry), entry) for entry in change.get("changed", ()))
        merged[part] = list(entries.values())
    return merged


class ServerQuestions(ABC):
    """Plans, configuration, emergency stop, approvals and recordings of a robot elsewhere.

    Where a server answers what the protocol does not have, each raises ControlMessageError.
    """

    @abstractmethod
    async def ask(self, op: str, kind: str = "", **more: Any) -> Any:
        """Send a control message and return the `jsonMessage` of its answer."""

    async def _answer(self, op: str, kind: str = "", **more: Any) -> Mapping[str, Any]:
        """Ask, and return an answer that is what the protocol says.

        Raises:
            ControlMessageError: it is another; the text names the field.
        """
        answer: Mapping[str, Any] = await self.ask(op, kind, **more)
        checked_answer({"op": op, "type": kind, **more}, answer)
        return answer

    async def functions(self) -> list[Mapping[str, Any]]:
        """Return the functions that one may see."""
        return list((await self._answer("List"))["functions"])

    @arguments()
    async def resolve(self, name: str) -> Mapping[str, Any]:
        """Return the plan of a function as data, and as text; raises ResolutionError."""
        return await self._answer("Resolve", name)

    @arguments()
    async def configure(
        self,
        text: str,
        *,
        dry_run: bool = False,
        force: bool = False,
        revision: int | None = None,
        keep: bool = False,
        reload_code: bool = False,
    ) -> Mapping[str, Any]:
        """Change the configuration of the robot; needs the right `configure`.

        Args:
            text: the whole configuration, YAML.
            dry_run: whether to say only what would happen.
            force: whether connections may end for it.
            revision: of the configuration that the change was made for; None: any.
            keep: whether it is written to the robot's file, too; needs the right `keep`.
            reload_code: whether the code of Python components is read again.

        Returns:
            `revision`, `differences`, `connections`, `is_applied`, `is_kept`, `time`, and `text`
            for people.

        Raises:
            ConfigurationError: it has mistakes, or would end connections, or components cannot be
                had with their new code.
            UsageError: another revision is in force.
            ServerError: the role may not.
        """
        what = {"text": text, "keep": keep, "reload_code": reload_code}
        return await self._change(what, dry_run, force, revision)

    @arguments()
    async def rollback(
        self,
        to: int,
        *,
        dry_run: bool = False,
        force: bool = False,
        revision: int | None = None,
        keep: bool = False,
    ) -> Mapping[str, Any]:
        """Have the configuration of an earlier revision again; otherwise as `configure`."""
        return await self._change({"rollback": to, "keep": keep}, dry_run, force, revision)

    async def _change(
        self,
        what: Mapping[str, Any],
        dry_run: bool,  # noqa: FBT001
        force: bool,  # noqa: FBT001
        revision: int | None,
    ) -> Mapping[str, Any]:
        wanted: dict[str, Any] = {**what, "dry_run": dry_run, "force": force}
        if revision is not None:
            wanted["revision"] = revision
        return await self._answer("Configure", jsonMessage=wanted)

    async def revisions(self) -> list[Mapping[str, Any]]:
        """Return the revisions of the configuration, the one in force last; needs `configure`."""
        return list((await self._answer("Configure"))["revisions"])

    async def discover(self) -> list[Mapping[str, Any]]:
        """Return what each bridge sees now; needs the right `see` for `*`.

        Returns:
            `bridge`, `plugin`, `configured`, `cause` where it sees nothing, `facts` of the plugin,
            `components` with their `ports`, `more` and `left_out`; also plugins without a bridge.
        """
        return list((await self._answer("Discover"))["bridges"])

    async def stop_all(self) -> Mapping[str, Any]:
        """Stop everything of the robot that moves, until `release`; needs the right `stop`.

        Returns:
            `stopped`: whether every open input that moves something has; `inputs`: for each whether
            it has, since when, or why not; `since`; and `text` for people.

        Raises:
            ServerError: the role may not.
        """
        return await self._answer("Stop")

    async def release(self) -> None:
        """Let commands through again; needs the right `release`.

        Raises:
            BridgeError: some inputs could not be reached, and go on refusing commands.
            ServerError: the role may not.
        """
        await self._answer("Stop", jsonMessage={"release": True})

    async def approvals(self) -> list[Mapping[str, Any]]:
        """Return what others ask for that one may approve, oldest first; needs `approve`.

        Returns:
            `approval`, `phase`, `requester`, `operation`, `function`, `arguments`, `digest`,
            `envelope`, `seconds`, `left`, `components`, `preview`, `approver`, `uses` and `cause`.
        """
        return list((await self._answer("Approve"))["approvals"])

    @arguments()
    async def approve(
        self, approval: str, *, approve: bool = True, digest: str = "", cause: str = ""
    ) -> Mapping[str, Any]:
        """Approve or refuse what another principal asks for; needs the right `approve`.

        Args:
            approval: which.
            approve: whether it may be done.
            digest: of the arguments that were shown; with others nothing is approved.
            cause: why, for who asked.

        Raises:
            ServerError: it is one's own, waits no more, or the role may not.
        """
        wanted: dict[str, Any] = {"approve": approve, "cause": cause}
        if digest:
            wanted["digest"] = digest
        return await self._answer("Approve", approval, jsonMessage=wanted)

    @arguments()
    async def record(
        self,
        *functions: str,
        duration: float | None = None,
        max_size: int | str | None = None,
        split: int | str | None = None,
        compression: str | None = None,
        ring: float | None = None,
    ) -> Mapping[str, Any]:
        """Have the server record functions into a file of its folder; needs `record` for each.

        It goes on without this client, until it is stopped or has what the server allows. Options
        are those of `RobotManager.record`.

        Returns:
            `recording`, its name, `state`, `files`, `channels` and more: see the protocol.

        Raises:
            ResolutionError: nothing fits.
            ServerError: the role may not, or too much is recorded already.
        """
        given = {
            "duration": duration,
            "max_size": max_size,
            "split": split,
            "compression": compression,
            "ring": ring,
        }
        options = {name: value for name, value in given.items() if value is not None}
        return await self._answer("Record", jsonMessage={"functions": list(functions), **options})

    async def recordings(self) -> Mapping[str, Any]:
        """Return the `recordings`, and for whom may record all also the `files` in their folder."""
        return await self._answer("Record")

    @arguments()
    async def stop_recording(self, recording: str) -> Mapping[str, Any]:
        """End a recording and return what is in it; that of another needs the right `kill`, too."""
        return await self._answer("Record", recording, jsonMessage={"stop": True})

    @arguments()
    async def dump_recording(self, recording: str) -> Mapping[str, Any]:
        """Write what a recording with a `ring` keeps in memory; `written` is the file."""
        return await self._answer("Record", recording, jsonMessage={"dump": True})

    async def players(self) -> list[Mapping[str, Any]]:
        """Return where the recordings are that bridges play."""
        return list((await self._answer("Play"))["players"])

    @arguments()
    async def playback(
        self,
        bridge: str,
        *,
        pause: bool | None = None,
        rate: float | str | None = None,
        seek: float | None = None,
        step: bool = False,
    ) -> Mapping[str, Any]:
        """Move the recording that a bridge plays, as `RobotManager.playback`; needs `record`."""
        given = {"pause": pause, "rate": rate, "seek": seek, "step": step or None}
        wanted = {name: value for name, value in given.items() if value is not None}
        message: dict[str, Any] = {"jsonMessage": wanted} if wanted else {}
        return await self._answer("Play", bridge, **message)


class ThreadAnswer:
    """An answer that one thread waits for, whatever thread it comes in.

    What comes first counts: the answer, a failure, or that it is not waited for any more. Has the
    methods of a future that who completes it calls.
    """

    __slots__ = ("_came", "_error", "_result", "_turn")

    def __init__(self) -> None:
        # Held until it is complete: who waits asks for it, which costs a tenth of a condition.
        self._came = threading.Lock()
        self._came.acquire()
        self._turn = [True]  # taken by who completes it: one of several threads gets it
        self._result: Any = None
        self._error: BaseException | None = None

    def done(self) -> bool:
        """Say whether it is complete."""
        return not self._turn

    def set_result(self, result: Any) -> None:
        """Complete it, unless it is."""
        self._complete(result, None)

    def set_exception(self, error: BaseException) -> None:
        """Have the wait for it fail, unless it is complete."""
        self._complete(None, error)

    def wait(self, timeout: float) -> Any:
        """Return the result, waiting so many seconds at most.

        Raises:
            TimeoutError: it did not come in time.
            BaseException: as it was failed with.
        """
        end = time.monotonic() + timeout
        while not self._came.acquire(timeout=wait_step(max(0.0, end - time.monotonic()))):
            if time.monotonic() >= end:
                raise TimeoutError
        if self._error is not None:
            raise self._error
        return self._result

    def _complete(self, result: Any, error: BaseException | None) -> None:
        try:
            self._turn.pop()
        except IndexError:
            return
        self._result, self._error = result, error
        self._came.release()
