"""Speech as a device: one service, one of two engines."""

from __future__ import annotations

import ctypes
import io
import re
import shutil
import subprocess
import tempfile
import threading
import time
import wave
from abc import ABC, abstractmethod
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

from attrs import frozen

from uoarm.bridge import at_exit, install_command, reason_of
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
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
from uoarm_rocos._options import DeviceOptions
from uoarm_rocos._structure import fit_given

__all__ = ["Engine", "EspeakEngine", "FestivalEngine", "Sound", "Speech", "speech_catalogue"]


_OCTETS = 2


@frozen
class Sound:
    """Mono samples of 16 bits, least significant octet first."""

    samples: bytes
    hertz: int

    @property
    def duration(self) -> float:
        """Seconds."""
        return len(self.samples) / _OCTETS / self.hertz

    def wav(self) -> bytes:
        """Return the sound as a WAV file."""
        file = io.BytesIO()
        with wave.open(file, "wb") as writer:
            writer.setnchannels(1)
            writer.setsampwidth(_OCTETS)
            writer.setframerate(self.hertz)
            writer.writeframes(self.samples)
        return file.getvalue()


class Engine(ABC):
    """Makes sound of text. Used by one thread at a time.

    Attributes:
        name: for people.
        voice: the voice where a request names none.
    """

    name: str
    voice: str

    @abstractmethod
    def check(self) -> None:
        """Make sure that the engine can be used.

        Raises:
            BridgeError: UNAVAILABLE, with what to install.
        """

    @abstractmethod
    def speak(self, text: str, voice: str, rate: float, timeout: float) -> Sound:
        """Return the sound of a text; `rate` 1.0 is the voice's own speed.

        Raises:
            BridgeTimeoutError: it takes longer than `timeout` seconds.
            BridgeError: there is no such voice, or the engine failed.
        """


_SYNCHRONOUS = 2
_RATE = 1
_UTF8 = 1
_WORDS_A_MINUTE = 175
# British English is the voice file that is called `en`.
_FILES = {"en-gb": "en"}
_CALLBACK = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int, ctypes.c_void_p
)
_SYNTH_ARGUMENTS = (
    ctypes.c_char_p,
    ctypes.c_size_t,
    ctypes.c_uint,
    ctypes.c_int,
    ctypes.c_uint,
    ctypes.c_uint,
    ctypes.c_void_p,
    ctypes.c_void_p,
)
# The library has one state for the whole process: one voice at a time for all callers.
_library_lock = threading.Lock()


class EspeakEngine(Engine):
    """Needs no audio device. There is no New Zealand voice; British English stands in."""

    name = "eSpeak NG"
    voice = "en-gb"

    def check(self) -> None:
        """Load the library, once for the whole process."""
        with _library_lock:
            _library()

    def speak(self, text: str, voice: str, rate: float, timeout: float) -> Sound:
        """Return the sound of a text."""
        end = time.monotonic() + timeout
        if not _library_lock.acquire(timeout=timeout):
            raise BridgeTimeoutError(f"eSpeak NG was busy for {timeout:g} s")
        try:
            library, hertz = _library()
            samples = _samples(library, text, voice, rate, end)
        finally:
            _library_lock.release()
        if time.monotonic() > end:
            raise BridgeTimeoutError(f"speaking took longer than {timeout:g} s")
        return Sound(samples, hertz)


@cache
def _library() -> tuple[Any, int]:
    """Return the library and its rate in hertz; beginning it twice would spoil its memory."""
    try:
        import espeakng_loader  # noqa: PLC0415 - an optional package
    except ImportError as error:
        text = f"eSpeak NG is not there: {_install()}"
        raise BridgeError(text, FailureReason.UNAVAILABLE) from error
    try:
        library = ctypes.CDLL(str(espeakng_loader.get_library_path()))
        data = str(espeakng_loader.get_data_path()).encode()
        hertz = int(library.espeak_Initialize(_SYNCHRONOUS, 0, data, 0))
    except (OSError, AttributeError) as error:
        text = f"eSpeak NG cannot be loaded: {reason_of(error)}"
        raise BridgeError(text, FailureReason.UNAVAILABLE) from error
    if hertz <= 0:
        text = f"eSpeak NG did not start: {hertz}; its data should be in {data.decode()}"
        raise BridgeError(text, FailureReason.UNAVAILABLE)
    library.espeak_Synth.argtypes = _SYNTH_ARGUMENTS
    return library, hertz


def _samples(library: Any, text: str, voice: str, rate: float, end: float) -> bytes:
    if library.espeak_SetVoiceByName(_FILES.get(voice, voice).encode()) != 0:
        text = f"eSpeak NG has no voice {voice!r}; it has en-gb, en-us, fr, de and many more"
        raise BridgeError(text, FailureReason.BAD_MESSAGE)
    library.espeak_SetParameter(_RATE, round(_WORDS_A_MINUTE * rate), 0)
    parts: list[bytes] = []

    def take(samples: Any, count: int, events: Any) -> int:
        del events
        if samples and count > 0:
            parts.append(ctypes.string_at(samples, 2 * count))
        return int(time.monotonic() > end)  # 1 ends the speech

    callback = _CALLBACK(take)
    library.espeak_SetSynthCallback(callback)
    said = text.encode() + b"\0"
    failed = library.espeak_Synth(said, len(said), 0, 0, 0, _UTF8, None, None)
    if failed:
        raise BridgeError(f"eSpeak NG failed with its error {failed}", FailureReason.RAISED)
    return b"".join(parts)


def _install() -> str:
    command = install_command("uoarm-rocos", "speech")
    return f"install it with: {command} (eSpeak NG, GPL-3.0-or-later)"


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
                text = f"Festival made no sound, perhaps for want of the voice {voice!r}"
                raise BridgeError(f"{text}: {reason_of(error)}") from error
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
            raise BridgeError(f"Festival cannot be started: {reason_of(error)}") from error
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

    def __init__(self, name: str, engine: Engine, options: DeviceOptions) -> None:
        self._name = name
        self._engine = engine
        self._voice = options.voice or engine.voice
        self._may_play = options.play == "auto"
        self._directory = options.directory or ""
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
        asked = fit_given(api.input, message, f"request to {api.name}")
        text = asked["text"].replace("\0", " ")  # at which engines end
        try:
            text.encode()
        except UnicodeEncodeError as error:
            raise MessageError(f"request to {api.name}.text: {error}") from error
        if not self._speaking.acquire(timeout=timeout):
            raise BridgeTimeoutError(f"{self._name} was still speaking after {timeout:g} s")
        try:
            self._check_open()
            left = max(0.0, end - time.monotonic())  # a lock takes no negative one
            voice, rate = asked.get("voice", self._voice), asked.get("rate", 1.0)
            sound = self._engine.speak(text, voice, rate, left)
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
            raise BridgeError(f"{command[0]} cannot be started: {reason_of(error)}") from error
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
            raise BridgeError(f"the sound cannot be written: {reason_of(error)}") from error
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
