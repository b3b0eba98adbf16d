"""Answers of a server: errors as ours, the status map, and one that a thread waits for."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from uoarm import errors

__all__ = ["ServerError", "ThreadAnswer", "error_of", "merged_status"]

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


def error_of(message: Mapping[str, Any]) -> errors.UoarmError:
    """Return what an Error of the server says, as the exception that is raised for it."""
    code, text = message["code"], message["text"]
    kind = _ERRORS.get(code)
    error = ServerError(code, text) if kind is None else kind(text)
    error.error_code = message.get("error_code", error.error_code)
    return error


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
        if not self._came.acquire(timeout=max(0.0, timeout)):
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
        entries = {key_of(entry): entry for entry in known[part]}
        if part == "routes":
            for key, route in entries.items():
                if route["age"] is not None:
                    entries[key] = {**route, "age": route["age"] + elapsed}
        for key in change.get("gone", ()):
            entries.pop(tuple(key) if isinstance(key, list) else key, None)
        entries.update((key_of(entry), entry) for entry in change.get("changed", ()))
        merged[part] = list(entries.values())
    return merged
