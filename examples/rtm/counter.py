"""An RT-Component that counts, twice a second; RT System Editor and rtshell see it too.

python examples/rtm/counter.py [HOST:PORT]
"""

from __future__ import annotations

import sys
import time

from uoarm_rtm.component import ComponentProfile, NamingService, Orb, RtComponent, Types


def main(nameserver: str) -> None:
    """Count until the component is asked to exit."""
    orb = Orb("127.0.0.1", call_seconds=2.0)
    component = RtComponent(orb, ComponentProfile("Counter0", type_name="Counter"))
    count = component.add_out_port("count", "RTC::TimedLong", Types())
    component.bind([NamingService(orb, nameserver, seconds=2.0)])
    print("Counter0.rtc counts")
    number = 0
    while not component.wait_for_exit(0.5):
        seconds, rest = divmod(time.time_ns(), 1_000_000_000)
        count.write({"tm": {"sec": seconds, "nsec": rest}, "data": number})
        number += 1
    component.close()
    orb.close()


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "localhost:2809")
