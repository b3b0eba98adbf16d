"""Recordings as clients begin, end and play them: of what they may see, in one folder, bounded."""

from __future__ import annotations

import errno
import os
import time
from collections.abc import Awaitable, Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

from uoarm import record as recorder
from uoarm.errors import UoarmError, UsageError
from uoarm.model import ControlMessage, QueuePolicy, Robot, to_json
from uoarm.server._failures import LimitError, UnknownError
from uoarm.server.access import Operation, RoleView
from uoarm.server.session._client import ConnectedClient
from uoarm.server.streams import FeedRegistry

RecordingAnswer: TypeAlias = "Callable[[ConnectedClient, RoleView, ControlMessage], Awaitable[Any]]"

_MOST_FILES = 200
_DUMP_SECONDS = 30.0
_PLAYED = "recording"


class RecordingRequests:
    """Answers what clients ask about recordings. In the loop; what takes time runs in a worker.

    A recording is of the server, not of the session that began it: a page may be closed meanwhile.

    Args:
        folder: of the files of recordings that clients begin; made when the first one does.
    """

    def __init__(self, registry: FeedRegistry, folder: Path) -> None:
        self._robot, self._workers, self._limits = registry.robot, registry.workers, registry.limits
        self._folder = folder
        # Those that clients began, by principal; what is not here the program or its
        # configuration records.
        self._owners: dict[str, str] = {}
        self._beginning = 0

    async def record(self, client: ConnectedClient, view: RoleView, asked: ControlMessage) -> Any:
        """Answer a Record: begin one, act on one, or list all. Raises as they do, or UsageError."""
        wanted = asked.jsonMessage
        if wanted is not None and "functions" in wanted:
            if asked.type:
                raise UsageError("a new recording has no name yet: leave the type empty")
            return await self.begin(client, view, wanted)
        if asked.type:
            return await self.act(client, view, str(asked.type), wanted or {})
        if wanted is not None:
            raise UsageError("say which recording: its name is the type")
        return await self.all(client, view)

    async def playback(self, client: ConnectedClient, view: RoleView, asked: ControlMessage) -> Any:
        """Answer a Play: move one, or list all; raises as those do, and UsageError."""
        if asked.type:
            return await self.play(client, view, str(asked.type), asked.jsonMessage or {})
        if asked.jsonMessage is not None:
            raise UsageError("say which bridge plays it: its name is the type")
        return {"players": await self.players(client, view)}

    async def begin(
        self, client: ConnectedClient, view: RoleView, wanted: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Begin a recording.

        Raises:
            DeniedError: it may not record one of the functions, or not receive it.
            LimitError: too many run, or the folder is full.
            UoarmError: as `RobotManager.record`.
        """
        functions, limits = wanted["functions"], self._limits
        for name in functions:
            for operation in (Operation.REQUEST, Operation.RECORD):
                client.require(operation, name.partition(".")[0])
        options = dict(wanted)
        del options["functions"]
        size = recorder.RecordOptions.of(max_size=options.get("max_size")).max_size
        options["max_size"] = min(size or limits.recording_bytes, limits.recording_bytes)
        running = [item for item in self._robot.recordings() if not item.ended]
        own = sum(item.id in self._owners for item in running) + self._beginning
        if own >= limits.recordings:
            raise LimitError(f"{own} recordings of clients run; stop one first")
        self._owners = {
            item.id: self._owners[item.id]
            for item in self._robot.recordings()
            if item.id in self._owners
        }
        self._beginning += 1
        try:
            recording = await self._workers.start(lambda: self._begin(functions, options))
        finally:
            self._beginning -= 1
        self._owners[recording.id] = client.principal
        return self._shown(recording, client, view)

    async def all(self, client: ConnectedClient, view: RoleView) -> dict[str, Any]:
        """Return the recordings that a client may see, and for whom may record all the files."""
        shown = [
            self._shown(item, client, view)
            for item in self._robot.recordings()
            if _sees(view, item.functions)
        ]
        if not (view.sees_all and client.role.allows_all(Operation.RECORD)):
            return {"recordings": shown}
        files = await self._workers.start(lambda: list(_files(self._folder)))
        return {"recordings": shown, "folder": str(self._folder), "files": files[:_MOST_FILES]}

    async def act(
        self, client: ConnectedClient, view: RoleView, name: str, wanted: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Stop a recording, write what it keeps in memory, or only return how it is.

        Raises:
            UnknownError: there is none of this name that the client may see.
            DeniedError: it may not record these functions; or another began it, and it may not
                kill what others hold.
            UsageError: it has nothing in memory, has ended, or its file cannot be written.
        """
        found = next((item for item in self._robot.recordings() if item.id == name), None)
        if found is None or not _sees(view, found.functions):
            raise UnknownError(f"there is no recording {name!r:.100}")
        written = {}
        if wanted:
            for operation in self._needed(client, found, stops="stop" in wanted):
                for function in found.functions:
                    client.require(operation, function.partition(".")[0])
        if "dump" in wanted:
            cause = f"it was asked for by {client.principal}"
            path = await self._workers.start(lambda: found.dump(cause, timeout=_DUMP_SECONDS))
            written = {"written": path if view.sees_all else Path(path).name}
        elif "stop" in wanted:
            await self._workers.free(found.close)
        return {**self._shown(found, client, view), **written}

    async def players(self, client: ConnectedClient, view: RoleView) -> list[dict[str, Any]]:
        """Return where the recordings are that bridges play, of those that a client may see."""
        names = [
            name
            for name, spec in self._robot.config.bridges.items()
            if spec.plugin == _PLAYED and view.has_bridge(name)
        ]

        def look() -> list[dict[str, Any]]:
            return [self._player(name, client, view, self._position(name)) for name in names]

        return await self._workers.start(look)

    async def play(
        self, client: ConnectedClient, view: RoleView, name: str, wanted: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Move the recording that a bridge plays, or only return where it is.

        Raises:
            UnknownError: there is no such bridge that the client may see.
            DeniedError: it may not record one of the functions that the bridge has a part in.
            UoarmError: as `RobotManager.playback`.
        """
        spec = self._robot.config.bridges.get(name)
        if spec is None or spec.plugin != _PLAYED or not view.has_bridge(name):
            raise UnknownError(f"there is no bridge {name!r:.100} that plays a recording")
        if wanted:
            functions = _functions_of(self._robot.config, name)
            for function in functions:
                client.require(Operation.RECORD, function)
            if not functions:
                client.require_all(Operation.RECORD)
        status = await self._workers.start(
            lambda: self._robot.playback(name, timeout=_DUMP_SECONDS, **wanted)
        )
        return self._player(name, client, view, status)

    def _begin(self, functions: list[str], options: dict[str, Any]) -> recorder.Recording:
        make_folder(self._folder)
        used = sum(file["octets"] for file in _files(self._folder))
        if used >= self._limits.recordings_bytes:
            raise LimitError(
                f"recordings have {used:,} octets, and may have {self._limits.recordings_bytes:,}: "
                f"remove some of {self._folder}, or serve with another folder (--recordings)"
            )
        name = time.strftime("%Y%m%d-%H%M%S.mcap", time.gmtime())
        return self._robot.record(
            *functions,
            path=self._folder / name,
            queue=QueuePolicy(length=10_000),
            timeout=self._limits.request_seconds,
            **options,
        )

    def _needed(
        self, client: ConnectedClient, recording: recorder.Recording, *, stops: bool
    ) -> tuple[Operation, ...]:
        is_own = self._owners.get(recording.id) == client.principal
        return (Operation.RECORD,) if is_own or not stops else (Operation.RECORD, Operation.KILL)

    def _shown(
        self, recording: recorder.Recording, client: ConnectedClient, view: RoleView
    ) -> dict[str, Any]:
        needed = self._needed(client, recording, stops=True)
        shown: dict[str, Any] = {
            "recording": recording.id,
            "functions": list(recording.functions),
            "ring": recording.ring,
            "owner": self._owners.get(recording.id, ""),
            "may_stop": all(
                client.role.allows(operation, function.partition(".")[0])
                for operation in needed
                for function in recording.functions
            ),
            **to_json(recording.status()),
        }
        if not view.sees_all:
            shown["files"] = [Path(path).name for path in shown["files"]]
        return dict(view.data(shown))

    def _position(self, name: str) -> recorder.PlaybackStatus | UoarmError:
        try:
            return self._robot.playback(name, timeout=_DUMP_SECONDS)
        except UoarmError as error:
            return error

    def _player(
        self,
        name: str,
        client: ConnectedClient,
        view: RoleView,
        found: recorder.PlaybackStatus | UoarmError,
    ) -> dict[str, Any]:
        functions = _functions_of(self._robot.config, name)
        role = client.role
        shown: dict[str, Any] = {
            "bridge": name,
            "functions": [function for function in functions if view.has_function(function)],
            "may_move": all(role.allows(Operation.RECORD, function) for function in functions)
            if functions
            else role.allows_all(Operation.RECORD),
        }
        if isinstance(found, UoarmError):
            return {**shown, "cause": view.text(str(found))}
        return {**shown, "cause": "", **to_json(found)}


def _sees(view: RoleView, functions: Iterable[str]) -> bool:
    return all(view.has_function(function.partition(".")[0]) for function in functions)


def _functions_of(robot: Robot, bridge: str) -> list[str]:
    """Return the functions that have a component in a bridge."""
    return sorted({item.function for item in robot.components() if item.bridge == bridge})


def make_folder(path: Path) -> None:
    """Make the folder of recordings, or see that it can be used.

    Raises:
        UsageError: it cannot.
    """
    try:
        path.mkdir(parents=True, exist_ok=True, mode=0o700)
        if not os.access(path, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise UsageError(
            f"recordings cannot be written to {path}: {error.strerror or error}"
        ) from error


def _files(folder: Path) -> list[dict[str, Any]]:
    """Return the recordings in a folder, newest first."""
    found = []
    for path in folder.glob("*.mcap"):
        try:
            stat = path.stat()
        except OSError:
            continue  # it was removed meanwhile
        found.append({"path": str(path), "octets": stat.st_size, "time": stat.st_mtime})
    return sorted(found, key=lambda file: -float(file["time"]))
