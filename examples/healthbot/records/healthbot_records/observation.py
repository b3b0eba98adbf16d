"""Measurements as FHIR R4 Observation resources, coded with LOINC and UCUM.

Codes: https://loinc.org (8867-4 heart rate, 59408-5 oxygen saturation by pulse oximetry, 85354-9
blood pressure panel with 8480-6 systolic and 8462-4 diastolic). Shape: FHIR R4, resource
Observation, profile vital signs.
"""

from __future__ import annotations

import uuid
from datetime import datetime
from typing import Any, Literal, TypedDict

from typing_extensions import NotRequired

__all__ = ["CODES", "Measurement", "identity", "observation"]

CODES = {"pulse": "8867-4", "spo2": "59408-5", "pressure": "85354-9"}
_NAMES = {
    "8867-4": "Heart rate",
    "59408-5": "Oxygen saturation in Arterial blood by Pulse oximetry",
    "85354-9": "Blood pressure panel",
    "8480-6": "Systolic blood pressure",
    "8462-4": "Diastolic blood pressure",
}
_UNITS = {"pulse": ("/min", "/min"), "spo2": ("%", "%")}
_IDENTIFYING = ("patient", "visit", "kind", "time", "value", "systolic")
_NAMESPACE = uuid.UUID("6f3c0f5e-6f0c-5b0a-9a54-0c1b7d1f2a10")


class Measurement(TypedDict):
    """What the robot measured: `value` for pulse and spo2, two values for pressure (mmHg).

    `visit` names the encounter. Two applications that read the same device in the same millisecond
    measure the same value at the same time; only their visits distinguish the two measurements.
    """

    patient: str
    kind: Literal["pulse", "spo2", "pressure"]
    time: str
    visit: NotRequired[str]
    value: NotRequired[float]
    systolic: NotRequired[float]
    diastolic: NotRequired[float]


def identity(measured: Measurement) -> str:
    """Return the id of a measurement: the same one for the same measurement, however often sent."""
    parts = (measured.get(key, "") for key in _IDENTIFYING)
    return str(uuid.uuid5(_NAMESPACE, "|".join(map(str, parts))))


def observation(measured: Measurement) -> dict[str, Any]:
    """Return the resource of a measurement.

    Raises:
        ValueError: a value is missing, or the time is no ISO 8601 time with an offset.
    """
    if datetime.fromisoformat(measured["time"].replace("Z", "+00:00")).tzinfo is None:
        raise ValueError(f"time {measured['time']!r} has no offset; write ...Z or ...+12:00")
    kind = measured["kind"]
    resource: dict[str, Any] = {
        "resourceType": "Observation",
        "id": identity(measured),
        "status": "final",
        "category": [{"coding": [_category()]}],
        "code": {"coding": [_coding(CODES[kind])]},
        "subject": {"reference": f"Patient/{measured['patient']}"},
        "effectiveDateTime": measured["time"],
    }
    if visit := measured.get("visit"):
        resource["encounter"] = {"identifier": {"value": visit}}
    if kind == "pressure":
        pairs = (("8480-6", "systolic"), ("8462-4", "diastolic"))
        resource["component"] = [
            {
                "code": {"coding": [_coding(code)]},
                "valueQuantity": _quantity(_value(measured, name), "mmHg", "mm[Hg]"),
            }
            for code, name in pairs
        ]
    else:
        unit, code = _UNITS[kind]
        resource["valueQuantity"] = _quantity(_value(measured, "value"), unit, code)
    return resource


def _value(measured: Measurement, name: str) -> float:
    value = measured.get(name)
    if not isinstance(value, int | float):
        text = f"{name!r} is missing for a measurement of {measured['kind']}"
        raise ValueError(text)  # noqa: TRY004 - missing, mostly
    return value


def _coding(code: str) -> dict[str, str]:
    return {"system": "http://loinc.org", "code": code, "display": _NAMES[code]}


def _category() -> dict[str, str]:
    system = "http://terminology.hl7.org/CodeSystem/observation-category"
    return {"system": system, "code": "vital-signs"}


def _quantity(value: float, unit: str, code: str) -> dict[str, Any]:
    return {"value": value, "unit": unit, "system": "http://unitsofmeasure.org", "code": code}
