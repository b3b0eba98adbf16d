"""What hostile clients do to a server, by name; each runs in a process of its own."""

from __future__ import annotations

import asyncio
import itertools
import json
import socket
import struct
import sys
import threading
import time
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any
from urllib.parse import urlsplit
from urllib.request import urlopen

import cbor2
from attrs import frozen
from tests.server.hostile import HOSTILE, Hostile, many
from websockets.asyncio.client import connect as connect_async
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

SECONDS = 5.0


@frozen
class Attack:
    """One attack.

    Attributes:
        sent: what is sent, in words.
        run: does it; returns how the server answered. May raise ConnectionClosed and OSError.
        functions: that are open meanwhile, `f0` and on.
    """

    sent: str
    run: Callable[[str], str]
    functions: int = 0


@contextmanager
def client(url: str, *, path: str = "/", binary: bool = False) -> Iterator[ClientConnection]:
    form = Subprotocol("uoarm.v1.cbor" if binary else "uoarm.v1.json")
    parts = urlsplit(url)
    with connect(
        f"ws://{parts.netloc}{path}", subprotocols=None if path != "/" else [form],
        max_size=None, compression=None, ping_interval=None, close_timeout=1,
    ) as made:  # fmt: skip
        if path == "/":
            made.recv()
        yield made


def counted(came: Counter[str]) -> str:
    """Return in words how often what came."""
    return ", ".join(f"{count} x {what}" if count > 1 else what for what, count in came.items())


def together(clients: int, act: Callable[[], None]) -> None:
    """Do it in so many threads, until all have ended."""
    threads = [threading.Thread(target=act) for _ in range(clients)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


def kind_of_answer(frame: str | bytes) -> str:
    """Return what one message of the server comes to, in a few words."""
    message: Any = json.loads(frame) if isinstance(frame, str) else cbor2.loads(frame)
    kind = message.get("op")
    if kind == "Error":
        return str(message["jsonMessage"]["code"])
    if kind == "status":
        return str(message["msg"]).partition(":")[0]
    return str(kind) if message.get("result", True) is not False else "refused"


def answers(made: ClientConnection, count: int, seconds: float = SECONDS) -> str:
    """Return what came, counted."""
    came: Counter[str] = Counter()
    end = time.monotonic() + seconds
    try:
        while came.total() < count:
            came[kind_of_answer(made.recv(timeout=max(0.0, end - time.monotonic())))] += 1
    except TimeoutError:
        came["no answer"] = count - came.total()
    except ConnectionClosed as error:
        came[f"closed {error.rcvd.code if error.rcvd else 'without a word'}"] += 1
    return counted(came)


def inputs(hostile: Hostile) -> Callable[[str], str]:
    def run(url: str) -> str:
        with client(url, binary=hostile.form == "cbor") as made:
            for frame in hostile.frames():
                made.send(frame)
            return answers(made, 1, 60)

    return run


def small_objects(url: str) -> str:
    with client(url, path="/rosbridge") as made:
        call = '{"op":"call_service","service":"/anything","id":"h","args":%s}'
        made.send(call % many('{"a":[]}'))
        return answers(made, 1, 60)


def latch(url: str) -> str:
    with client(url, path="/rosbridge") as made:
        message = json.dumps({"data": ["1234567890"] * 300_000})
        for number in range(30):
            head = f'{{"op":"publish","topic":"/t{number}","latch":true,"id":"p","msg":'
            made.send(f"{head}{message}}}")
        return answers(made, 30)


def numbers() -> str:
    return json.dumps({"data": [number * 1.001 for number in range(100_000)]})


def opened(made: ClientConnection) -> str:
    made.send('{"op":"Request","type":"hang","id":"r"}')
    answer = json.loads(made.recv(timeout=30))
    return str(answer["jsonMessage"].get("connection", ""))


def data(url: str) -> str:
    message, came = numbers(), Counter[str]()
    for _ in range(4):
        with client(url) as made:
            connection = opened(made)
            for number in range(20) if connection else ():
                head = f'{{"op":"Data","type":"{connection}","id":"d{number}","jsonMessage":'
                made.send(f"{head}{message}}}")
            came["sent, and left" if connection else "not opened"] += 1
    return counted(came)


def kills(url: str) -> str:
    came: Counter[str] = Counter()
    for _ in range(10):
        with client(url) as made:
            connection = opened(made)
            if connection:
                head = f'"type":"{connection}"'
                made.send(f'{{"op":"Data",{head},"id":"d","jsonMessage":{{"data":[1.0]}}}}')
                for number in range(100):
                    made.send(f'{{"op":"Kill",{head},"id":"k{number}"}}')
            came["killed" if connection else "not opened"] += 1
    return counted(came)


def hanging_calls(url: str) -> str:
    call = '{"op":"Call","type":"sleep","id":"c%d","x-timeout":0.01,"jsonMessage":{"a":1,"b":1}}'
    with client(url) as made:
        for number in range(400):
            made.send(call % number)
            if number % 20 == 19:
                time.sleep(0.1)
        return answers(made, 400)


def plain(url: str, *, deflate: bool = False) -> socket.socket:
    """Return a socket after a handshake, which is never read."""
    more = "Sec-WebSocket-Extensions: permessage-deflate\r\n" if deflate else ""
    parts = urlsplit(url)
    made = socket.create_connection((str(parts.hostname), int(parts.port or 0)), timeout=SECONDS)
    made.sendall(
        f"GET / HTTP/1.1\r\nHost: {parts.netloc}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
        f"{more}\r\n".encode()
    )
    while deflate and b"\r\n\r\n" not in made.recv(4096):
        pass
    return made


def flood(opcode: Opcode, content: bytes) -> Callable[[str], str]:
    def run(url: str) -> str:
        end = time.monotonic() + SECONDS
        frames = Frame(opcode, content).serialize(mask=True) * 2000
        sent = 0
        with plain(url) as made:
            made.settimeout(SECONDS)
            try:
                while time.monotonic() < end:
                    made.sendall(frames)
                    sent += 2000
            except TimeoutError:
                return f"{sent:,} sent, then read no more"
            except OSError:
                return f"{sent:,} sent, then cut off"
        return f"{sent:,} sent"

    return run


def half_open(url: str) -> str:
    parts = urlsplit(url)
    made = []
    with suppress(OSError):
        for _ in range(500):
            client = socket.create_connection(
                (str(parts.hostname), int(parts.port or 0)), timeout=2
            )
            client.sendall(b"GET / HTTP/1.1\r\nHost: ")
            made.append(client)
    time.sleep(SECONDS)
    return f"{len(made)} open"


def packed(text: bytes) -> bytes:
    """Return a text as permessage-deflate has it."""
    packer = zlib.compressobj(9, wbits=-15)
    return (packer.compress(text) + packer.flush(zlib.Z_SYNC_FLUSH))[:-4]


def masked(first: int, content: bytes) -> bytes:
    """Return a frame by its first octet, masked with zeros, which costs the sender nothing."""
    length = len(content)
    head = struct.pack("!BBQI", first, 0xFF, length, 0)
    return (struct.pack("!BBI", first, 0x80 | length, 0) if length < 126 else head) + content


def unfinished(clients: int, frames: bytes) -> Callable[[str], str]:
    """Send the beginning of a message from so many clients, and then answer pings."""

    def run(url: str) -> str:
        came: Counter[str] = Counter()
        made = [plain(url, deflate=True) for _ in range(clients)]
        for client in made:
            client.settimeout(SECONDS)
            with suppress(OSError):
                client.sendall(frames)
        end = time.monotonic() + SECONDS
        while time.monotonic() < end:
            for client in made:
                with suppress(OSError):
                    client.sendall(masked(0x8A, b""))
            time.sleep(0.5)
        for client in made:
            came[ending(client)] += 1
        return counted(came)

    return run


def ending(made: socket.socket) -> str:
    """Return how the server ended a connection, after whatever it said."""
    made.settimeout(0.05)
    octets = b""
    try:
        while data := made.recv(65536):
            octets += data
    except TimeoutError:
        return "held"
    except OSError:
        return "cut off"
    finally:
        made.close()
    at = octets.rfind(b"\x88")
    return f"closed {int.from_bytes(octets[at + 2 : at + 4], 'big')}" if at >= 0 else "cut off"


def bombs(clients: int) -> Callable[[str], str]:
    """Send messages that become a thousand times as long, as fast as they are taken."""
    call = b'{"op":"Call","type":"add","id":"b","jsonMessage":{"a":"%s"}}'
    bomb = masked(0xC1, packed(call % (b" " * 16_000_000)))

    def run(url: str) -> str:
        sent: Counter[str] = Counter()

        def send() -> None:
            end = time.monotonic() + SECONDS
            while time.monotonic() < end:
                with suppress(OSError), plain(url, deflate=True) as made:
                    made.settimeout(SECONDS)
                    while time.monotonic() < end:
                        made.sendall(bomb)
                        sent["sent"] += 1
                        with suppress(BlockingIOError):
                            made.recv(65536, socket.MSG_DONTWAIT)

        together(clients, send)
        return f"{sent['sent']} x {len(bomb):,} octets sent"

    return run


def crowd(clients: int, *frames: str, path: str = "/", again: bool = False) -> Callable[[str], str]:
    """Ask questions from so many clients, as fast as answers come.

    Args:
        clients: how many.
        frames: the questions, of which each has the id `q`; `%d` is the number of the client.
        path: of the endpoint.
        again: to connect anew after each answer, as a page does that is loaded again.
    """

    def run(url: str) -> str:
        return asyncio.run(_crowded(url.rstrip("/") + path, clients, frames, again=again))

    return run


async def _crowded(url: str, clients: int, frames: tuple[str, ...], *, again: bool) -> str:
    answered: Counter[str] = Counter()
    waits: list[float] = []
    octets = 0
    end = time.monotonic() + SECONDS

    async def ask(number: int) -> None:
        nonlocal octets
        questions = itertools.cycle(frames)
        while time.monotonic() < end:
            async with connect_async(
                url, max_size=None, compression=None, ping_interval=None, close_timeout=1
            ) as made:
                while time.monotonic() < end:
                    question = next(questions)
                    since = time.monotonic()
                    await made.send(question % number if "%d" in question else question)
                    answer = await made.recv()
                    while '"q"' not in answer[:200] and '"q"' not in answer[-200:]:
                        answer = await made.recv()
                    waits.append(time.monotonic() - since)
                    octets += len(answer)
                    is_error = '"op":"Error"' in answer[:200] or '"result":false' in answer[:200]
                    answered["refused" if is_error else "answered"] += 1
                    if again:
                        break

    outcomes = await asyncio.gather(*map(ask, range(clients)), return_exceptions=True)
    for outcome in outcomes:
        if outcome is not None:
            answered[type(outcome).__name__] += 1
    return f"{counted(answered)}, {octets / 1e6:,.0f} MB, worst after {max(waits, default=0):.1f} s"


def pages(clients: int) -> Callable[[str], str]:
    """Read the metrics from so many clients, again and again."""

    def run(url: str) -> str:
        parts = urlsplit(url)
        came: Counter[str] = Counter()

        def read() -> None:
            end = time.monotonic() + SECONDS
            while time.monotonic() < end:
                try:
                    with urlopen(f"http://{parts.netloc}/metrics", timeout=60) as page:
                        came[f"{page.status} with {len(page.read()) // 1000:,} KB"] += 1
                except OSError as error:
                    came[str(error)] += 1

        together(clients, read)
        return counted(came)

    return run


STATUS = '{"op":"Status","id":"q"}'
WATCH = '{"op":"Status","type":"watch","id":"q"}'
LIST = '{"op":"List","id":"q"}'
RESOLVE = '{"op":"Resolve","type":"f%d","id":"q"}'
ROSAPI = '{"op":"call_service","id":"q","service":"/rosapi/%s","args":%s}'
MANY = 1000
FRAGMENT = b" " * 1_000_000
FRAGMENTS = masked(0x01, FRAGMENT) + masked(0x00, FRAGMENT) * 15
PACKED_FRAGMENTS = masked(0x41, packed(FRAGMENT * 16))


def one_input(name: str) -> Attack:
    return Attack(f"one frame: {name}", inputs(HOSTILE[name]))


ATTACKS: Mapping[str, Attack] = {
    "dimensions": one_input("60,000 dimensions"),
    "huge": one_input("huge dimensions"),
    "lists": one_input("empty lists"),
    "objects": Attack("one frame of small objects to rosbridge", small_objects),
    "cbor-lists": one_input("empty lists in CBOR"),
    "latch": Attack("30 latched topics, 4 MB each", latch),
    "data": Attack("4 times 20 x 2 MB for a component that hangs, then gone", data),
    "kills": Attack("10 times 100 kills of what hangs", kills),
    "calls": Attack("400 calls that hang, given up after 10 ms", hanging_calls),
    "pings": Attack("pings for five seconds, nothing read", flood(Opcode.PING, b"")),
    "tiny": Attack("List for five seconds, nothing read", flood(Opcode.TEXT, LIST.encode())),
    "half-open": Attack("500 handshakes that do not go on", half_open),
    "id": one_input("dimensions as the id"),
    "fragments": Attack("16 fragments of 1 MB, no last", unfinished(1, FRAGMENTS)),
    "fragments-200": Attack("the same from 200 clients", unfinished(200, FRAGMENTS)),
    "packed": Attack("15 KB that become 16 MB, no last", unfinished(1, PACKED_FRAGMENTS)),
    "packed-200": Attack("the same from 200", unfinished(200, PACKED_FRAGMENTS)),
    "bombs": Attack("16 MB in 15.5 KB for five seconds from 8 clients", bombs(8)),
    "bombs-200": Attack("the same from 200 clients", bombs(200)),
    "status": Attack("Status from 200 clients", crowd(200, STATUS), MANY),
    "watch": Attack("Status watch, List from 200, connecting anew",
        crowd(200, WATCH, LIST, again=True), MANY,
    ),
    "list": Attack("List from 200 clients", crowd(200, LIST), MANY),
    "resolve": Attack("Resolve from 200 clients", crowd(200, RESOLVE), MANY),
    "topics": Attack("rosapi/topics_and_raw_types from 8 clients",
        crowd(8, ROSAPI % ("topics_and_raw_types", "{}"), path="/rosbridge"), MANY,
    ),
    "topic-type": Attack("rosapi/topic_type from 200 clients",
        crowd(200, ROSAPI % ("topic_type", '{"topic":"/uoarm/f%d"}'), path="/rosbridge"), MANY,
    ),
    "metrics": Attack("metrics from 20 clients", pages(20), MANY),
}  # fmt: skip


def main() -> None:
    """Run the attack of a name on a server; prints how it answered."""
    name, url = sys.argv[1:]
    try:
        print(ATTACKS[name].run(url))
    except (ConnectionClosed, OSError) as error:
        print(f"{type(error).__name__}: {error}")


if __name__ == "__main__":
    main()
