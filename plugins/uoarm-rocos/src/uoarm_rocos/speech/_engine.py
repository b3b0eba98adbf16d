"""What an engine of speech is to the rest, and sound as it comes from one."""

from __future__ import annotations

import io
import wave
from abc import ABC, abstractmethod

from attrs import frozen

__all__ = ["Engine", "Sound"]

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
        voice: the voice where nobody names one.
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
