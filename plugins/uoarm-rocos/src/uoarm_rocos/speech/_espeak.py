"""eSpeak NG through its C library, which the package espeakng-loader brings (GPL-3.0-or-later).

The calls and numbers are those of eSpeak NG's `speak_lib.h`.
"""

from __future__ import annotations

import ctypes
import threading
import time
from functools import cache
from typing import Any

from uoarm.bridge import install_command
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason
from uoarm_rocos.speech._engine import Engine, Sound

__all__ = ["EspeakEngine"]

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
# The library has one state for the whole process: one voice at a time, whoever asks.
_one_at_a_time = threading.Lock()


class EspeakEngine(Engine):
    """Needs no audio device. There is no New Zealand voice; British English stands in."""

    name = "eSpeak NG"
    voice = "en-gb"

    def check(self) -> None:
        """Load the library, once for the whole process."""
        with _one_at_a_time:
            _library()

    def speak(self, text: str, voice: str, rate: float, timeout: float) -> Sound:
        """Return the sound of a text."""
        end = time.monotonic() + timeout
        if not _one_at_a_time.acquire(timeout=timeout):
            raise BridgeTimeoutError(f"eSpeak NG was busy for {timeout:g} s")
        try:
            library, hertz = _library()
            samples = _samples(library, text, voice, rate, end)
        finally:
            _one_at_a_time.release()
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
        text = f"eSpeak NG cannot be loaded: {error}"
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
