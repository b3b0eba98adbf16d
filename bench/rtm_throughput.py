"""Messages a second from an OutPort to an InPort: connected directly, by uoarm, to an application.

Two components in processes of their own: one writes as fast as its OutPort takes (`flush`), the
other counts and prints nothing. Each way is measured in turn, several times over, so that what else
the machine does falls on all of them.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import threading
import time
from typing import Any

from bench.tables import print_table

SECONDS, TURNS = 1.5, 5
SMALL, LARGE = "IDL:RTC/TimedLong:1.0", "IDL:RTC/TimedOctetSeq:1.0"
OCTETS = 131_072
WAYS = {
    "connected directly": "direct",
    "relayed, with a map": "relayed",
    "to an application": "out",
}
CONFIGURATION = """
version: 1
bridges: {{rtm: {{plugin: rtm, options: {{nameserver: "{address}"}}}}}}
functions:
  out: {{components: [{{name: talker, bridge: rtm, output: {{endpoint: [Talker.rtc, {port}]}}}}]}}
  direct:
    components:
      - {{name: plain, bridge: rtm, input: {{from: out, endpoint: [Counter.rtc, {port}]}}}}
  relayed:
    components:
      - name: mapped
        bridge: rtm
        input: {{from: out, endpoint: [Counter.rtc, {port}], map: {{tm: tm, data: data}}}}
"""


def main() -> int:
    """Print the table; 0 also when there is no omniORB to measure."""
    try:
        from uoarm_rtm._nameserver import NameServer  # noqa: PLC0415
    except ImportError as error:
        print(f"no throughput table: {error}", file=sys.stderr)
        return 0
    with NameServer() as names:
        talker, counter = (_start(names.address, role) for role in ("Talker", "Counter"))
        rows: list[tuple[str, ...]] = []
        for port, what in (("small", "TimedLong"), ("large", f"{OCTETS // 1024} kB")):
            rates = _rates(names.address, port, talker, counter)
            direct = statistics.median(rates["direct"])
            for name, way in WAYS.items():
                rate = statistics.median(rates[way])
                spread = f"{min(rates[way]):,.0f} to {max(rates[way]):,.0f}"
                rows.append((f"{what}, {name}", f"{rate:,.0f}", spread, f"{rate / direct:.2f}"))
        for process in (talker, counter):
            process.communicate(timeout=20)
    head = ("way", "messages a second, median", "least to most", "of direct")
    print_table("From an OutPort to an InPort", head, rows)
    return 0


def _rates(address: str, port: str, talker: Any, counter: Any) -> dict[str, list[float]]:
    from uoarm import RobotManager  # noqa: PLC0415
    from uoarm.config import loads  # noqa: PLC0415

    rates: dict[str, list[float]] = {way: [] for way in WAYS.values()}
    with RobotManager(loads(CONFIGURATION.format(address=address, port=port))) as robot:
        for _ in range(TURNS):
            for way, found in rates.items():
                taken = [0]

                def take(_: Any, taken: list[int] = taken) -> None:
                    taken[0] += 1

                with robot.request(way, timeout=20.0) as connection:
                    if way == "out":
                        connection.subscribe(take)
                    before = _ask(counter, "count")
                    seconds = float(_ask(talker, port))
                    came = int(_ask(counter, "count")) - int(before)
                found.append((taken[0] if way == "out" else came) / seconds)
    return rates


def _start(address: str, role: str) -> Any:
    words = [sys.executable, "-m", "bench.rtm_throughput", role, address]
    process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.readline()
    return process


def _ask(process: Any, word: str) -> str:
    process.stdin.write(word + "\n")
    process.stdin.flush()
    return str(process.stdout.readline())


def serve(role: str, address: str) -> None:
    """Be one of the components, until standard input ends."""
    from uoarm_rtm._naming import NamingService  # noqa: PLC0415
    from uoarm_rtm._orb import Orb  # noqa: PLC0415
    from uoarm_rtm._types import Types  # noqa: PLC0415
    from uoarm_rtm.component import RtComponent, Sheet  # noqa: PLC0415

    orb, types, came, lock = Orb("127.0.0.1", 20.0), Types(), [0], threading.Lock()

    def take(_: Any) -> None:
        with lock:
            came[0] += 1

    component = RtComponent(orb, Sheet(role))
    tm = {"sec": 1, "nsec": 2}
    messages: dict[str, Any] = {"small": {"tm": tm, "data": 7},
                                "large": {"tm": tm, "data": bytes(OCTETS)}}  # fmt: skip
    ports: dict[str, Any] = {}
    for port, kind in (("small", SMALL), ("large", LARGE)):
        if role == "Counter":
            component.add_in_port(port, kind, types, take)
        else:
            ports[port] = component.add_out_port(port, kind, types)
    component.bind([NamingService(orb, address, 20.0)], f"{role}.rtc")
    component.lifecycle.activate()
    print("ready", flush=True)
    for line in sys.stdin:
        word = line.strip()
        if word == "count":
            print(came[0], flush=True)
            continue
        begun = time.perf_counter()
        while time.perf_counter() - begun < SECONDS:
            ports[word].write(messages[word])
        print(time.perf_counter() - begun, flush=True)
    component.close()
    orb.close()


if __name__ == "__main__":
    if len(sys.argv) > 1:
        serve(*sys.argv[1:3])
    else:
        sys.exit(main())
