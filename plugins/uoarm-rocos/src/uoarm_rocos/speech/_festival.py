"""Festival, the engine of the paper, through the command text2wave of Debian's package."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
import wave
from pathlib import Path

from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm_rocos.speech._engine import Engine, Sound

__all__ = ["FestivalEngine"]

_VOICE = re.compile(r"[a-z0-9_]+")
_INSTALL = "install it with: apt install festival festvox-kallpc16k"


class FestivalEngine(Engine):
    """Starts a process for each text."""

    name = "Festival"
    voice = "kal_diphone"

    def check(self) -> None:
        """Look for the command."""
        self._command()

    def speak(self, text: str, voice: str, rate: float, timeout: float) -> Sound:
        """Return the sound of a text."""
        if not _VOICE.fullmatch(voice):
            text = f"{voice!r} is no name of a Festival voice, such as kal_diphone"
            raise BridgeError(text, FailureReason.BAD_MESSAGE)
        # No TemporaryDirectory: a child that is forked meanwhile and ends would remove it.
        directory = tempfile.mkdtemp(prefix="uoarm-festival-")
        try:
            made = Path(directory) / "said.wav"  # to a pipe it writes a header without lengths
            self._run(text, voice, rate, timeout, made)
            try:
                return _sound(made)
            except (OSError, wave.Error, EOFError) as error:
                text = f"Festival made no sound, perhaps for want of the voice {voice!r}: {error}"
                raise BridgeError(text) from error
        finally:
            shutil.rmtree(directory, ignore_errors=True)

    def _run(self, text: str, voice: str, rate: float, timeout: float, made: Path) -> None:
        stretch = f"(Parameter.set 'Duration_Stretch {1 / rate:.3f})"
        command = [self._command(), "-o", str(made), "-eval", f"(voice_{voice})", "-eval", stretch]
        try:
            done = subprocess.run(  # noqa: S603 - no shell, and every word is ours or checked
                command,
                input=f"{text}\n".encode(),
                capture_output=True,
                timeout=timeout,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise BridgeTimeoutError(f"Festival took longer than {timeout:g} s") from error
        except OSError as error:
            raise BridgeError(f"Festival cannot be started: {error}") from error
        if done.returncode:
            message = done.stderr.decode(errors="replace").strip()[:200]
            text = f"Festival failed, perhaps for want of the voice {voice!r}: {message}"
            raise BridgeError(text, FailureReason.RAISED)

    def _command(self) -> str:
        command = shutil.which("text2wave")
        if command is None:
            text = f"Festival's text2wave is not there: {_INSTALL}"
            raise BridgeError(text, FailureReason.UNAVAILABLE)
        return command


def _sound(path: Path) -> Sound:
    with wave.open(str(path)) as reader:
        if (reader.getnchannels(), reader.getsampwidth()) != (1, 2):
            raise BridgeError("Festival made sound that is not mono of 16 bits")
        if not reader.getnframes():
            raise BridgeError("Festival made a sound without any samples")
        return Sound(reader.readframes(reader.getnframes()), reader.getframerate())
