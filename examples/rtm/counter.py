"""An RT-Component that counts, twice a second; RT System Editor and rtshell see it too.

python examples/rtm/counter.py [HOST:PORT]
"""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import os
import sys
import time
from contextlib import closing, suppress

from uoarm_rtm.component import ComponentProfile, NamingService, Orb, RtComponent, Types

from uoarm.errors import UoarmError


def main(nameserver: str) -> None:
    """Count until interrupted, or until the component is asked to exit."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    with (
        suppress(KeyboardInterrupt),
        closing(Orb("127.0.0.1", call_seconds=2.0)) as orb,
        closing(RtComponent(orb, ComponentProfile("Counter0", type_name="Counter"))) as component,
    ):
        count = component.add_out_port("count", "RTC::TimedLong", Types())
        component.bind([NamingService(orb, nameserver, seconds=2.0)])
        print("Counter0.rtc counts", flush=True)
        counted = 0
        while not component.wait_for_exit(0.5):
            seconds, rest = divmod(time.time_ns(), 1_000_000_000)
            count.write({"tm": {"sec": seconds, "nsec": rest}, "data": counted})
            counted += 1


if __name__ == "__main__":
    try:
        main(sys.argv[1] if len(sys.argv) > 1 else "localhost:2809")
    except UoarmError as failure:
        sys.exit(str(failure))
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)
