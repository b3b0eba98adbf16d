"""The speech component: text in, sound out, played where there is something to play it."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from uoarm.bridge import at_exit
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm_rocos._catalogue import (
    Api,
    ApiKind,
    BooleanField,
    DeviceCatalogue,
    NamedField,
    NumberField,
    OctetsField,
    StringField,
)
from uoarm_rocos._device import Device
from uoarm_rocos._structure import fit
from uoarm_rocos.speech._engines import Engine, Sound

__all__ = ["Speech", "speech_catalogue"]

_MOST_TEXT = 1000
_MOST_AUDIO = 16_777_216


def speech_catalogue(engine: str) -> DeviceCatalogue:
    """Return the one service, `speechGeneration`."""
    takes = {
        "text": NamedField(StringField(max_length=_MOST_TEXT)),
        "voice": NamedField(StringField(max_length=64), required=False),
        "rate": NamedField(NumberField(0.5, 2.0), required=False),
    }
    gives = {
        "audio": NamedField(OctetsField(_MOST_AUDIO)),
        "duration": NamedField(NumberField(0.0, None, "s")),
        "played": NamedField(BooleanField()),
        "file": NamedField(StringField(), required=False),
    }
    text = "Says a text; answers the sound as a WAV file when it has been said."
    api = Api("speechGeneration", ApiKind.SERVICE, takes, gives, None, text)
    return DeviceCatalogue(engine, {api.name: api})


class Speech(Device):
    """Speaks one text after the other.

    Args:
        name: for file names.
        engine: makes the sound.
        options: `voice`, `play` (`auto` or `never`), `directory`; without one, files are written
            to a temporary directory that `close` removes.
    """

    def __init__(self, name: str, engine: Engine, options: Mapping[str, Any]) -> None:
        self._name = name
        self._engine = engine
        self._voice = str(options.get("voice", engine.voice))
        self._may_play = options.get("play", "auto") == "auto"
        self._directory = options.get("directory", "")
        self._forget_exit: Callable[[], None] | None = None
        # Held while a text is said: one at a time, and no temporary directory removed under it.
        self._speaking = threading.Lock()
        self._count = 0
        self._player: subprocess.Popen[bytes] | None = None
        self._closed = False

    def catalogue(self, timeout: float) -> DeviceCatalogue:
        """Return the catalogue if the engine can be used."""
        del timeout
        self._engine.check()
        return speech_catalogue(self._engine.name)

    def call(self, api: Api, message: object, timeout: float) -> dict[str, Any]:
        """Say a text; the answer comes when it has been said, or written to a file."""
        end = time.monotonic() + timeout
        asked = fit(api.input, message, f"request to {api.name}")
        if not self._speaking.acquire(timeout=timeout):
            raise BridgeTimeoutError(f"{self._name} was still speaking after {timeout:g} s")
        try:
            self._check_open()
            left = max(0.0, end - time.monotonic())  # a lock takes no negative one
            voice, rate = asked.get("voice", self._voice), asked.get("rate", 1.0)
            sound = self._engine.speak(asked["text"], voice, rate, left)
            self._check_open()
            if len(sound.samples) > _MOST_AUDIO - 100:
                raise BridgeError(f"the sound of {sound.duration:.0f} s is too long for a message")
            answer = {"audio": sound.wav(), "duration": sound.duration, "played": False}
            player = _player() if self._may_play else None
            if player is not None:
                self._play(player, sound, end)
                answer["played"] = True
            else:
                answer["file"] = str(self._write(sound))
            return answer
        finally:
            self._speaking.release()
            if self._closed:
                self._tidy()

    def stop(self) -> None:
        """End what is being said."""
        self._closed = True
        player = self._player
        if player is not None:
            player.kill()

    def close(self) -> None:
        """End what is being said, and leave no temporary file behind."""
        self.stop()
        self._tidy()

    def _check_open(self) -> None:
        if self._closed:
            raise BridgeError(f"{self._name} is closed", FailureReason.CLOSED)

    def _play(self, command: list[str], sound: Sound, end: float) -> None:
        try:
            player = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE)  # noqa: S603 - ours
        except OSError as error:
            raise BridgeError(f"{command[0]} cannot be started: {error}") from error
        with player:
            self._player = player
            if self._closed:  # before it was there to be killed
                player.kill()
            try:
                _, report = player.communicate(sound.wav(), max(0.0, end - time.monotonic()))
            except subprocess.TimeoutExpired as error:
                player.kill()
                raise BridgeTimeoutError(f"{self._name} was interrupted by its limit") from error
            finally:
                self._player = None
        if player.returncode:
            said = report.decode(errors="replace").strip()[:200]
            raise BridgeError(f"{command[0]} could not play the sound: {said}")

    def _write(self, sound: Sound) -> Path:
        self._count += 1
        try:
            if not self._directory:
                # No TemporaryDirectory: a forked child that ends would remove it.
                self._directory = tempfile.mkdtemp(prefix="uoarm-speech-")
                self._forget_exit = at_exit(partial(shutil.rmtree, self._directory, True))
            path = Path(self._directory) / f"{self._name}-{self._count % 100:02}.wav"
            path.write_bytes(sound.wav())
        except OSError as error:
            raise BridgeError(f"the sound cannot be written: {error}") from error
        return path

    def _tidy(self) -> None:
        """Remove the temporary directory, or leave it to the call that is still writing there."""
        if self._speaking.acquire(blocking=False):
            try:
                if self._forget_exit is not None:
                    self._forget_exit()
                    shutil.rmtree(self._directory, ignore_errors=True)
            finally:
                self._speaking.release()


def _player() -> list[str] | None:
    """Return the command that plays a WAV file from its input, if there is an audio device."""
    aplay = shutil.which("aplay")
    devices = list(Path("/dev/snd").glob("pcmC*p")) if aplay else []
    return [aplay, "--quiet", "-"] if aplay and devices else None
