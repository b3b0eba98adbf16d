"""An RT-Component that says again what it receives.

python examples/rtm/parrot.py [HOST:PORT]
"""

from __future__ import annotations

import queue
import sys
from pathlib import Path
from typing import Any

from uoarm_rtm.component import ComponentProfile, NamingService, Orb, RtComponent, Types


def main(nameserver: str) -> None:
    """Talk until the component is asked to exit."""
    orb = Orb("127.0.0.1", call_seconds=2.0)
    component = RtComponent(orb, ComponentProfile("Parrot0", type_name="Parrot"))
    types = Types([str(Path(__file__).parent / "words.idl")])
    received: queue.Queue[Any] = queue.Queue(maxsize=100)
    component.add_in_port("listen", "Example::Words", types, received.put)
    say = component.add_out_port("say", "Example::Words", types)
    component.bind([NamingService(orb, nameserver, seconds=2.0)])
    print("Parrot0.rtc listens")
    while not component.wait_for_exit(0.0):
        try:
            message = received.get(timeout=0.2)
        except queue.Empty:
            continue
        say.write({"text": f"{message['text']}, {message['text']}"})
    component.close()
    orb.close()


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "localhost:2809")
