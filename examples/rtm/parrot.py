"""An RT-Component that says again what it receives.

python examples/rtm/parrot.py [HOST:PORT]
"""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import os
import queue
import sys
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

from uoarm_rtm.component import ComponentProfile, NamingService, Orb, RtComponent, Types

from uoarm.errors import UoarmError


def main(nameserver: str) -> None:
    """Talk until interrupted, or until the component is asked to exit."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)
    types = Types([str(Path(__file__).parent / "words.idl")])
    received: queue.Queue[Any] = queue.Queue(maxsize=100)
    with (
        suppress(KeyboardInterrupt),
        closing(Orb("127.0.0.1", call_seconds=2.0)) as orb,
        closing(RtComponent(orb, ComponentProfile("Parrot0", type_name="Parrot"))) as component,
    ):
        component.add_in_port("listen", "Example::Words", types, received.put)
        say = component.add_out_port("say", "Example::Words", types)
        component.bind([NamingService(orb, nameserver, seconds=2.0)])
        print("Parrot0.rtc listens", flush=True)
        while not component.wait_for_exit(0.0):
            try:
                message = received.get(timeout=0.2)
            except queue.Empty:
                continue
            say.write({"text": f"{message['text']}, {message['text']}"})


if __name__ == "__main__":
    try:
        main(sys.argv[1] if len(sys.argv) > 1 else "localhost:2809")
    except UoarmError as failure:
        sys.exit(str(failure))
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)
