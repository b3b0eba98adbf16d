"""From an OutPort to an InPort: connected directly, relayed by uoarm or by hand, to an application.

Two components in processes of their own: one writes, as fast as its OutPort takes (`flush`) or 200
times a second, the other counts and prints nothing. Each way is measured in turn, several times
over, so that what else the machine does falls on all of them.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from bench.tables import at, print_table

SECONDS, TURNS = 1.5, 5
SMALL, LARGE = "IDL:RTC/TimedLong:1.0", "IDL:RTC/TimedOctetSeq:1.0"
OCTETS, MOST_OCTETS = 131_072, 4_194_304
HERTZ = 200
PORTS = {"small": SMALL, "large": LARGE, "newest": LARGE}
WHAT = {"small": "TimedLong", "large": "128 kB", "newest": f"4 MB, {HERTZ} times a second"}
WAYS = {
    "connected directly": "direct",
    "relayed by hand, in one thread": "by hand 0",
    "relayed by hand, a thread between": "by hand 1",
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
        input:
          from: out
          endpoint: [Counter.rtc, {port}]
          map: {{tm: tm, data: data}}
          queue: {queue}
"""
QUEUES = {"small": "{}", "large": "{}", "newest": "{policy: latest}"}


def main() -> int:
    """Print the tables; 0 also when there is no omniORB to measure."""
    try:
        from uoarm_rtm._nameserver import NameServer  # noqa: PLC0415
    except ImportError as error:
        print(f"no throughput table: {error}", file=sys.stderr)
        return 0
    with NameServer() as names:
        talker, counter = (_start(names.address, role) for role in ("Talker", "Counter"))
        ports = sys.argv[1:] or list(PORTS)
        found = {port: _found(names.address, port, talker, counter) for port in ports}
        for process in (talker, counter):
            process.communicate(timeout=20)
    _print_rates({port: found[port] for port in ports if port != "newest"})
    if "newest" in found:
        _print_delays(found["newest"])
    print(f"\nload {os.getloadavg()[0]:.0f}")
    return 0


def _print_rates(found: dict[str, dict[str, list[tuple[float, list[float]]]]]) -> None:
    rows: list[tuple[str, ...]] = []
    for port, ways in found.items():
        rates = {way: [rate for rate, _ in turns] for way, turns in ways.items()}
        direct = statistics.median(rates["direct"])
        for name, way in WAYS.items():
            rate = statistics.median(rates[way])
            spread = f"{min(rates[way]):,.0f} to {max(rates[way]):,.0f}"
            rows.append((f"{WHAT[port]}, {name}", f"{rate:,.0f}", spread, f"{rate / direct:.2f}"))
    head = ("way", "messages a second, median", "least to most", "of direct")
    print_table("From an OutPort to an InPort", head, rows)


def _print_delays(ways: dict[str, list[tuple[float, list[float]]]]) -> None:
    rows, direct = [], 0.0
    for name, way in WAYS.items():
        delays = sorted(delay for _, turn in ways[way] for delay in turn)
        rate = statistics.median(rate for rate, _ in ways[way])
        median = at(delays, 0.5)
        direct = direct or median
        times = f"{median * 1000:.1f}", f"{at(delays, 0.99) * 1000:.1f}", f"{median / direct:.1f}"
        rows.append((name, f"{rate:.0f}", *times))
    head = ("way", "a second", "latency, median (ms)", "p99", "of direct")
    print_table(WHAT["newest"], head, rows)


def _found(
    address: str, port: str, talker: Any, counter: Any
) -> dict[str, list[tuple[float, list[float]]]]:
    """Return of each way and turn the messages a second, and how old each was (seconds)."""
    from uoarm import RobotManager  # noqa: PLC0415
    from uoarm.config import loads  # noqa: PLC0415

    found: dict[str, list[tuple[float, list[float]]]] = {way: [] for way in WAYS.values()}
    text = CONFIGURATION.format(address=address, port=port, queue=QUEUES[port])
    with RobotManager(loads(text)) as robot:
        for _ in range(TURNS):
            for way, turns in found.items():
                mine: list[float] = []

                def take(message: Any, mine: list[float] = mine) -> None:
                    mine.append(_age(message))

                with _opened(way, robot, address, port, take):
                    _ask(counter, "taken")
                    seconds = float(_ask(talker, port))
                    theirs = [float(each) for each in _ask(counter, "taken").split()]
                ages = mine if way == "out" else theirs
                turns.append((len(ages) / seconds, ages))
    return found


@contextmanager
def _opened(
    way: str, robot: Any, address: str, port: str, take: Callable[[Any], None]
) -> Iterator[None]:
    """Have the two components connected."""
    from bench._rtm_bare_relay import BareRelay  # noqa: PLC0415

    if way.startswith("by hand"):
        waiting = 0 if way.endswith("0") else 1 if port == "newest" else 16
        relay = BareRelay(address, port, PORTS[port], waiting)
        try:
            yield
        finally:
            relay.close()
        return
    with robot.request(way, timeout=20.0) as connection:
        if way == "out":
            connection.subscribe(take)
        yield


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


def _now() -> dict[str, int]:
    sec, nsec = divmod(time.monotonic_ns(), 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def _age(message: Any) -> float:
    """Return how many seconds ago a message was written, on this machine."""
    now, then = _now(), message["tm"]
    return float(now["sec"] - then["sec"] + (now["nsec"] - then["nsec"]) * 1e-9)


def serve(role: str, address: str) -> None:
    """Be one of the components, until standard input ends."""
    from uoarm_rtm._naming import NamingService  # noqa: PLC0415
    from uoarm_rtm._orb import Orb  # noqa: PLC0415
    from uoarm_rtm._types import Types  # noqa: PLC0415
    from uoarm_rtm.component import RtComponent, Sheet  # noqa: PLC0415

    orb, types, lock = Orb("127.0.0.1", 20.0), Types(), threading.Lock()
    ages: list[float] = []

    def take(message: Any) -> None:
        with lock:
            ages.append(_age(message))

    component = RtComponent(orb, Sheet(role))
    data: dict[str, Any] = {"small": 7, "large": bytes(OCTETS), "newest": bytes(MOST_OCTETS)}
    ports: dict[str, Any] = {}
    for port, kind in PORTS.items():
        if role == "Counter":
            component.add_in_port(port, kind, types, take)
        else:
            ports[port] = component.add_out_port(port, kind, types)
    component.bind([NamingService(orb, address, 20.0)], f"{role}.rtc")
    component.lifecycle.activate()
    print("ready", flush=True)
    for line in sys.stdin:
        word = line.strip()
        if word == "taken":
            with lock:
                print(*ages, flush=True)
                ages.clear()
            continue
        period = 1 / HERTZ if word == "newest" else 0.0
        begun = due = time.perf_counter()
        while time.perf_counter() - begun < SECONDS:
            ports[word].write({"tm": _now(), "data": data[word]})
            if period:
                due = max(due + period, time.perf_counter())
                time.sleep(max(0.0, due - time.perf_counter()))
        print(time.perf_counter() - begun, flush=True)
    component.close()
    orb.close()


if __name__ == "__main__":
    if len(sys.argv) == 3 and sys.argv[1] in {"Talker", "Counter"}:
        serve(*sys.argv[1:])
    else:
        sys.exit(main())
