"""A patient record without a service: one line of JSON a measurement, in a file of this machine."""

from __future__ import annotations

import json
import os
import uuid
from pathlib import Path
from typing import Literal, TypedDict

from typing_extensions import NotRequired

__all__ = ["Journal", "Measurement", "Receipt"]

_NAMESPACE = uuid.UUID("3b5c2f52-8a6e-4f0e-8a0b-7c6d7b6b0d11")


class Measurement(TypedDict):
    """What the robot measured: `value` for pulse and spo2, two values for pressure (mmHg)."""

    patient: str
    kind: Literal["pulse", "spo2", "pressure"]
    time: str
    visit: NotRequired[str]
    value: NotRequired[float]
    systolic: NotRequired[float]
    diastolic: NotRequired[float]


class Receipt(TypedDict):
    """What became of it."""

    id: str
    stored: bool
    waiting: int


class Journal:
    """Appends measurements to a file.

    Args:
        file: made if need be, for its owner alone.
    """

    def __init__(self, file: str) -> None:
        self._file = Path(file)

    def __call__(self, measured: Measurement) -> Receipt:
        """Write one measurement, on the disk when this returns."""
        line = json.dumps(measured, sort_keys=True)
        how = os.O_WRONLY | os.O_CREAT | os.O_APPEND
        with os.fdopen(os.open(self._file, how, 0o600), "w", encoding="utf-8") as out:
            out.write(line + "\n")
            out.flush()
            os.fsync(out.fileno())
        return {"id": str(uuid.uuid5(_NAMESPACE, line)), "stored": True, "waiting": 0}
