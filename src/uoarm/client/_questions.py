"""What a client asks a server that opens no stream, and an answer that a thread waits for."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from uoarm._arguments import arguments
from uoarm._interrupts import wait_step
from uoarm.client._answers import checked_answer


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
