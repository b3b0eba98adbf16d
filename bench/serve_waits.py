"""How old messages are where one client asks for much: `python -m bench.serve_waits`.

Many topics at one time, a client that reads too slowly, and small messages behind pictures of 2 MB.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import sys
import time

from websockets.asyncio.client import connect
from websockets.typing import Subprotocol

from bench.serve_clients import Speaker, native, own_server
from bench.tables import print_table, row

Row = tuple[str, ...]
READS = 20
READ_PAUSE = 0.02
SOURCES = {
    "hz100": ("texts", 100, 100),
    "hz4000": ("texts", 4000, 1000),
    "pictures": ("images", 10, 2_000_000),
}


async def subscribed(url: str, topics: int) -> Row:
    """Return how long it took until each of the topics had its first message at one client."""
    async with connect(f"{url}rosbridge", max_size=None, compression=None) as client:
        start = time.perf_counter()
        for number in range(topics):
            await client.send(json.dumps({"op": "subscribe", "topic": f"/uoarm/t{number}"}))
        waiting, refused = {f"/uoarm/t{number}" for number in range(topics)}, 0
        while len(waiting) > refused:
            told = json.loads(await asyncio.wait_for(client.recv(), 60))
            refused += told["op"] == "status"
            waiting.discard(told.get("topic", ""))
        took = time.perf_counter() - start
    return f"{topics} topics to one client", f"{took:.1f} s to the last", f"{refused} refused"


async def requested(url: str, topics: int) -> Row:
    """Return the same for the native protocol."""
    async with native(url) as speaker:
        start = time.perf_counter()
        for number in range(topics):
            asked = {"op": "Request", "type": f"t{number}", "id": str(number)}
            await speaker.socket.send(speaker.dump(asked))
        waiting, refused = set[str](), 0
        answered = 0
        while waiting or answered < topics:
            told = speaker.load(await asyncio.wait_for(speaker.socket.recv(), 60))
            if told["op"] == "Data":
                waiting.discard(told["type"])
            elif told["op"] == "Reply":
                answered += 1
                waiting.add(told["jsonMessage"]["connection"])
            elif told["op"] == "Error":
                answered += 1
                refused += 1
        took = time.perf_counter() - start
    return f"{topics} functions to one client", f"{took:.1f} s to the last", f"{refused} refused"


async def starved(url: str, seconds: float) -> Row:
    """Return how old messages are for a client that reads 1,000 of 4,000 a second."""
    ages = []
    async with connect(
        url, subprotocols=[Subprotocol("uoarm.v1.json")], compression=None, max_queue=1
    ) as reader:
        speaker = Speaker(reader, binary=False)
        await reader.recv()
        await speaker.ask(op="Request", type="hz4000")
        begun = time.monotonic()
        while time.monotonic() < begun + seconds:
            await asyncio.sleep(READ_PAUSE)
            for _ in range(READS):
                told = speaker.load(await reader.recv())
                ages.append((time.monotonic_ns() - told["jsonMessage"]["time"]) / 1000)
        reader.transport.abort()
    late = ages[len(ages) // 2 :]  # by then whatever fills is full
    return row(f"a client that reads {len(ages) / seconds:,.0f} of 4,000 a second", sorted(late))


async def beside_pictures(url: str, seconds: float, *, pictures: bool) -> Row:
    """Return how old small messages are, with pictures of 2 MB on the same connection or not."""
    ages = []
    async with native(url, binary=True) as speaker:
        name = (await speaker.ask(op="Request", type="hz100"))["connection"]
        if pictures:
            await speaker.ask(op="Request", type="pictures")
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            told = speaker.load(await speaker.socket.recv())
            if told["op"] == "Data" and told["type"] == name:
                ages.append((time.monotonic_ns() - told["jsonMessage"]["time"]) / 1000)
    what = "beside 10 pictures of 2 MB a second" if pictures else "alone"
    return row(f"100 small messages a second, {what}", sorted(ages[50:]))


async def measure(topics: int, seconds: float) -> None:
    """Print both tables."""
    ticks = {f"t{number}": ("ticks", 1, 100) for number in range(topics)}
    async with own_server({**SOURCES, **ticks}) as (url, _):
        ages = [await beside_pictures(url, seconds, pictures=one) for one in (False, True) * 2]
        ages.append(await starved(url, 2 * seconds))
        print_table("Age of messages on arrival (us)", ("what", "median", "p99", ""), ages)
        several = [await subscribed(url, topics), await requested(url, topics)]
        print_table("Topics", ("what", "", ""), several)
    print(f"load {os.getloadavg()[0]:.0f}")


def main() -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--topics", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=5.0)
    chosen = parser.parse_args()
    asyncio.run(measure(chosen.topics, chosen.seconds))
    return 0


if __name__ == "__main__":
    sys.exit(main())
