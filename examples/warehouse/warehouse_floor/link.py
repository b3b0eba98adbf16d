"""What a vehicle's program, or an experiment, says to the floor over UDP."""

from __future__ import annotations

import json
import os
import socket
from typing import Any, Final

from typing_extensions import Self

from warehouse_floor.bodies import Sense, Triple

__all__ = ["Base", "FloorLink"]

_SECONDS: Final = 1.0
_OCTETS: Final = 65_507


class FloorLink:
    """Asks and gets an answer. For one thread.

    Args:
        port: of the floor, on loopback; None: that of the environment variable WAREHOUSE_FLOOR.
        seconds: that an answer may take.
    """

    def __init__(self, port: int | None = None, seconds: float = 20.0) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port or int(os.environ["WAREHOUSE_FLOOR"])))
        self._socket.settimeout(seconds)
        self._number = 0

    def ask(self, **asked: Any) -> dict[str, Any]:
        """Ask, and return the answer.

        Raises:
            TimeoutError: none came in time.
            OSError: no process is there.
            ValueError: the floor refused, and why.
        """
        self._number += 1
        self._socket.send(json.dumps({**asked, "number": self._number}).encode())
        answer: dict[str, Any] = {}
        while answer.pop("number", None) != self._number:  # an earlier one came too late
            answer = json.loads(self._socket.recv(_OCTETS))
        if "error" in answer:
            raise ValueError(f"the floor refused {asked}: {answer['error']}")
        return answer

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Base:
    """The base of one vehicle: motors and sensors.

    Args:
        name: of the vehicle.
        home: where it stands when the floor has never seen it.
        is_holonomic: whether it moves sideways.
    """

    def __init__(self, name: str, home: str, *, is_holonomic: bool = False) -> None:
        self._link = FloorLink(seconds=_SECONDS)
        self._same = {"vehicle": name, "home": home, "is_holonomic": is_holonomic}

    def drive(self, velocity: Triple, until: float, carry: str) -> Sense | None:
        """Command the base and return what it senses; None where the floor did not answer.

        Args:
            velocity: forward and left in metres a second, turn in radians a second.
            until: by the monotonic clock, when the command that allows this is not live any more.
            carry: the box that it shall carry.
        """
        try:
            answer = self._link.ask(**self._same, velocity=velocity, until=until, carry=carry)
        except OSError:
            return None
        return Sense(**answer)

    def close(self) -> None:
        """Close the socket; the base stands soon after."""
        self._link.close()
