"""A cart that moves in every direction, as an RT-Component; it is steered from outside.

InPorts `velocity` (RTC::TimedVelocity2D, the seconds of whose time name the leg) and `carry`
(RTC::TimedString), OutPorts `pose` (RTC::TimedPose2D) and `status` (Warehouse::Status). It stands
when no command came for a while, as the controller of a base does.
"""

from __future__ import annotations

import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any, Final

from uoarm_rtm.component import ComponentProfile, NamingService, Orb, RtComponent, Types
from warehouse_floor.bodies import Sense
from warehouse_floor.link import Base
from warehouse_floor.navigator import STAND

_IDL: Final = Path(__file__).parents[1] / "warehouse.idl"
_SECONDS: Final = 0.05
_EVERY: Final = 2
_CALL_SECONDS: Final = 2.0
_LIVE: Final = 0.7  # as long as the configuration has a velocity live, and the way to here


class Cart:
    """The component.

    Args:
        name: of the vehicle.
        home: where it stands at first.
        nameserver: where it binds itself.
    """

    def __init__(self, name: str, home: str, nameserver: str) -> None:
        types = Types([str(_IDL)])
        self._base = Base(name, home, is_holonomic=True)
        self._velocity, self._until, self._leg = STAND, float("-inf"), 0
        self._wanted: str | None = None
        self._orb = Orb("127.0.0.1", _CALL_SECONDS)
        profile = ComponentProfile(f"{name}0", "Cart", "carries boxes", category="Vehicle")
        component = self._component = RtComponent(self._orb, profile)
        component.add_in_port("velocity", "RTC::TimedVelocity2D", types, self._steer)
        component.add_in_port("carry", "RTC::TimedString", types, self._carry)
        self._pose = component.add_out_port("pose", "RTC::TimedPose2D", types)
        self._status = component.add_out_port("status", "Warehouse::Status", types)
        component.bind([NamingService(self._orb, nameserver, _CALL_SECONDS)])

    def run(self, stop: threading.Event) -> None:
        """Drive and report until a signal comes, or until the component is ended."""
        load, ticks = "", 0
        while not stop.wait(_SECONDS) and not self._component.wait_for_exit(0):
            until = self._until
            # The controller's own timeout, should the stop message have got lost.
            velocity = self._velocity if time.monotonic() < until else STAND
            wanted = load if self._wanted is None else self._wanted
            sense = self._base.drive(velocity, until, wanted)
            if sense is not None:
                load = sense.load
                if ticks % _EVERY == 0:
                    self._report(sense)
            ticks += 1

    def close(self) -> None:
        """Leave the naming service."""
        self._component.close()
        self._orb.close()
        self._base.close()

    def _steer(self, message: Any) -> None:
        velocity = message["data"]
        self._velocity = (velocity["vx"], velocity["vy"], velocity["va"])
        self._until, self._leg = time.monotonic() + _LIVE, message["tm"]["sec"]

    def _carry(self, message: Any) -> None:
        self._wanted = message["data"]

    def _report(self, sense: Sense) -> None:
        seconds, rest = divmod(time.time_ns(), 1_000_000_000)
        stamp = {"sec": seconds, "nsec": rest}
        status = {
            "tm": stamp,
            "battery": sense.battery,
            "load": sense.load,
            "localised": sense.is_localised,
            "blocked": sense.is_blocked,
            "leg": self._leg,
        }
        pose = {"position": {"x": sense.x, "y": sense.y}, "heading": sense.heading}
        self._status.write(status)
        self._pose.write({"tm": stamp, "data": pose})


def main() -> None:
    """Serve `NAME HOME NAMESERVER` until interrupted."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: threading.Thread(target=stop.set).start())
    cart = Cart(*sys.argv[1:4])
    print("ready", flush=True)
    try:
        cart.run(stop)
    finally:
        cart.close()


if __name__ == "__main__":
    main()
