"""A thermometer that is unplugged after a while, and an alarm that reads it."""

from collections.abc import Iterator
from typing import TypedDict


class Reading(TypedDict):
    """What a thermometer gives."""

    celsius: float


class Alarm(TypedDict):
    """Whether it burns."""

    fire: bool


def thermometer(*, fails: bool = False) -> Iterator[Reading]:
    """Yield twenty readings; one that fails is unplugged after ten of them."""
    for number in range(20):
        if fails and number == 10:  # noqa: PLR2004 - in the middle
            raise OSError("the thermometer was unplugged")
        yield {"celsius": 20.0 + 5 * number}


def alarm(reading: Reading) -> Alarm:
    """Say that it burns above 90 degrees."""
    return {"fire": reading["celsius"] > 90}  # noqa: PLR2004 - a limit of fire alarms
