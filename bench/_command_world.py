"""What the bench of commands does its faults to: sinks, links, a broker, a server and a client."""

from __future__ import annotations

import getpass
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

from bench._command_parts import FUNCTIONS, OFFLINE, PRESENCE, TOPIC
from bench._command_proxy import Proxy

__all__ = ["LIFETIME", "PERIOD", "Line", "Part", "World", "until"]

LIFETIME = 0.25
PERIOD = 0.05
PATIENCE = 600.0
MACHINE = "arm"
_JUST_NOW_SECONDS = 0.5
ROBOT = f"""
version: 1
hosts: {{{{listen: "tcp/127.0.0.1:{{joining}}", silence: 10}}}}
bridges:
  ros2: {{{{plugin: ros2, host: {{{{silence: 10, start: 300, restarts: 1000}}}}}}}}
  rtm:
    plugin: rtm
    options: {{{{nameserver: "{{nameserver}}"}}}}
    host: {{{{silence: 10, start: 300, restarts: 1000}}}}
  rocos:
    plugin: rocos
    options: {{{{devices: {{{{robot: {{{{url: "{{url}}"}}}}}}}}}}}}
    host: {{{{silence: 10, start: 300, restarts: 1000}}}}
  mqtt:
    plugin: mqtt
    options:
      url: "{{broker}}"
      presence: {{{{topic: {PRESENCE}, online: online, offline: {OFFLINE}}}}}
    host: {{{{silence: 10, start: 300, restarts: 1000}}}}
  far: {{{{plugin: ros2, host: {{{{machine: {MACHINE}, silence: 10, start: 300}}}}}}}}
functions:
  ros2:
    components:
      - name: node
        bridge: ros2
        input:
          endpoint: [/go, std_msgs/msg/Int64]
          lifetime: {LIFETIME}
          stop: {{{{message: {{{{data: 0}}}}}}}}
  rtm:
    components:
      - name: rtc
        bridge: rtm
        input:
          endpoint: [Sink0.rtc, go, "IDL:RTC/TimedLong:1.0"]
          options: {{{{activate: true}}}}
          lifetime: {LIFETIME}
          stop: {{{{message: {{{{tm: {{{{sec: 0, nsec: 0}}}}, data: 0}}}}}}}}
  rocos:
    components:
      - name: device
        bridge: rocos
        input:
          endpoint: [robot, velocity]
          lifetime: {LIFETIME}
          stop: {{{{message: {{{{linear: 0, angular: 0}}}}}}}}
  mqtt:
    components:
      - name: topic
        bridge: mqtt
        input:
          endpoint: [{TOPIC}]
          options: {{{{qos: 0}}}}
          structure:
            type: object
            properties: {{{{stamp: {{{{type: integer}}}}}}}}
            required: [stamp]
          lifetime: {LIFETIME}
          stop: {{{{message: {{{{stamp: 0}}}}}}}}
  far:
    components:
      - name: remote
        bridge: far
        input:
          endpoint: [/far, std_msgs/msg/Int64]
          lifetime: {LIFETIME}
          stop: {{{{message: {{{{data: 0}}}}}}}}
"""

_ports = iter(range(20_000 + os.getpid() % 5_000, 32_000))
Line = tuple[float, str, str]
"""When, what (`go`, `stop`, `told`, `late`), and what more there is to it."""


class Part:
    """A process, whose output is in a file."""

    def __init__(self, folder: Path, *arguments: str) -> None:
        self.file = folder / f"{arguments[0]}-{time.monotonic_ns()}"
        with self.file.open("wb") as out:
            command = [sys.executable, "-m", "bench._command_parts", *arguments]
            self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=out)
        self._read = 0
        self._words: list[list[str]] = []

    def words(self) -> list[list[str]]:
        """Return the lines that it wrote; of one that is being written, nothing."""
        with self.file.open("rb") as file:
            file.seek(self._read)
            data = file.read()
        whole = data[: data.rfind(b"\n") + 1]
        self._read += len(whole)
        self._words += [line.split() for line in whole.decode().splitlines()]
        return self._words

    def lines(self) -> list[Line]:
        """Return the lines that begin with a time."""
        return [(float(one[0]), one[1], one[2] if one[2:] else "") for one in self.words()
                if one[0][0].isdigit()]  # fmt: skip

    def says(self, word: str) -> str:
        """Wait for a line that begins with a word, and return the next word."""
        until(lambda: any(one[0] == word for one in self.words()), f"{self.file.name} says {word}")
        return next(one[1] for one in self.words() if one[0] == word)

    def go(self) -> None:
        """Have it begin that waits for a line."""
        assert self.process.stdin is not None
        self.process.stdin.write(b"\n")
        self.process.stdin.flush()

    def end(self) -> None:
        """Kill it."""
        self.process.kill()
        self.process.wait()
        assert self.process.stdin is not None
        self.process.stdin.close()


class Broker:
    """Mosquitto, which comes back at the same address after it was killed."""

    def __init__(self, folder: Path) -> None:
        program = shutil.which("mosquitto") or "/usr/sbin/mosquitto"
        self.port = _free_port()
        file = folder / "mosquitto.conf"
        lines = (f"user {getpass.getuser()}", f"listener {self.port} 127.0.0.1",
                 "allow_anonymous true", "set_tcp_nodelay true", "")  # fmt: skip
        file.write_text("\n".join(lines))
        self._command = [program, "-c", str(file)]
        self.start()

    def start(self) -> None:
        """Start it, and wait until it answers."""
        self.process = subprocess.Popen(self._command, stderr=subprocess.DEVNULL)
        until(self._answers, "Mosquitto answers")

    def end(self) -> None:
        """Kill it."""
        self.process.kill()
        self.process.wait()

    def _answers(self) -> bool:
        with suppress(OSError):
            socket.create_connection(("127.0.0.1", self.port), 1).close()
            return True
        return False


def until(ready: Callable[[], object], what: str, seconds: float = PATIENCE) -> None:
    """Wait, ten minutes at most: on a busy machine a world may take some to begin."""
    deadline = time.monotonic() + seconds
    while not ready():
        if time.monotonic() > deadline:
            raise TimeoutError(what)
        time.sleep(0.01)


class World:
    """Everything that runs: what lasts, and the server and client of this moment.

    Attributes:
        sinks: by function.
        broker: of MQTT.
        clients: the link between client and server.
        machines: the link between server and the host of the other machine.
        clock: who writes down how late the machine wakes a thread.
    """

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        from uoarm_rtm._nameserver import NameServer  # noqa: PLC0415

        self.folder = folder
        nameserver = stack.enter_context(NameServer())
        self.broker = Broker(folder)
        stack.callback(self.broker.end)
        given = {
            "ros2": ("/go",), "far": ("/far",), "rocos": (),
            "rtm": (f"127.0.0.1:{nameserver.port}",), "mqtt": ("127.0.0.1", str(self.broker.port)),
        }  # fmt: skip
        self.sinks = {name: Part(folder, name, *given[name]) for name in FUNCTIONS}
        self.clock = Part(folder, "tick")
        for one in (*self.sinks.values(), self.clock):
            stack.callback(one.end)
        self._port, joining = _free_port(), _free_port()
        self.clients, self.machines = Proxy(self._port), Proxy(joining)
        stack.callback(self.clients.close)
        stack.callback(self.machines.close)
        text = ROBOT.format(
            joining=joining,
            nameserver=f"127.0.0.1:{nameserver.port}",
            url=self.sinks["rocos"].says("url"),
            broker=f"mqtt://127.0.0.1:{self.broker.port}",
        )
        (folder / "robot.yaml").write_text(text)
        self.server: Part | None = None
        self.client: Part | None = None
        self.next_client = self._make_client()
        self.machine: Part | None = None
        self.begun = 0.0
        self.url = f"ws://127.0.0.1:{self._port}/"
        stack.callback(self.end)

    def begin(self) -> None:
        """Have all sinks commanded."""
        if self.server is None:
            self.server = Part(
                self.folder, "serve", str(self.folder / "robot.yaml"), str(self._port)
            )
            self.server.says("port")
        if self.machine is None:
            place = f"tcp/127.0.0.1:{self.machines.port}"
            self.machine = Part(self.folder, "join", place, "--machine", MACHINE, "--silence", "10")
        self.begun = time.monotonic()
        if self.client is None:
            self.client, self.next_client = self.next_client, self._make_client()
            self.client.go()
        try:
            until(lambda: all(map(self.is_commanded, FUNCTIONS)), "all sinks are commanded")
        except TimeoutError as error:
            idle = [name for name in FUNCTIONS if not self.is_commanded(name)]
            raise TimeoutError(f"nobody commands {idle}") from error

    def _make_client(self) -> Part:
        """Make one that only waits to begin, since to start Python takes its time."""
        url = f"ws://127.0.0.1:{self.clients.port}/"
        return Part(self.folder, "send", url, str(PERIOD))

    def is_commanded(self, name: str) -> bool:
        """Say whether a sink took a command just now."""
        recent = self.seen(name, max(self.begun, time.monotonic() - _JUST_NOW_SECONDS))
        return any(what == "go" for _, what, _ in recent)

    def seen(self, name: str, since: float) -> list[Line]:
        """Return the messages that a sink took since a moment."""
        return [one for one in self.sinks[name].lines() if one[0] >= since and one[1] != "told"]

    def told(self, name: str, since: float) -> list[Line]:
        """Return what its framework told a sink since a moment."""
        return [one for one in self.sinks[name].lines() if one[0] >= since and one[1] == "told"]

    def host(self, name: str) -> int:
        """Return the process of a bridge's host."""
        if name == "far":
            assert self.machine is not None
            return self.machine.process.pid
        assert self.server is not None
        parent = self.server.process.pid
        for each in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                if int((each / "stat").read_text().rpartition(")")[2].split()[1]) != parent:
                    continue
                words = (each / "cmdline").read_bytes().split(b"\0")
                if b"--bridge" in words and words[words.index(b"--bridge") + 1] == name.encode():
                    return int(each.name)
        raise LookupError(f"the host of {name}")

    def settle(self, fault: str) -> None:
        """Put away what a fault left: everything passes again, and who was killed is no more."""
        assert self.server is not None
        assert self.client is not None
        if fault in {"client SIGKILL", "client link cut", "server SIGKILL"}:
            self.client.end()
            self.client = None
        else:
            self.client.process.send_signal(signal.SIGCONT)
        if fault == "server SIGKILL":
            self._end_server()
        else:
            self.server.process.send_signal(signal.SIGCONT)
        self.clients.mend()
        self.machines.mend()
        if self.machine is not None and self.machine.process.poll() is not None:
            self.machine = None

    def end(self) -> None:
        """End what is left of them all."""
        self.close()
        self.next_client.end()

    def _end_server(self) -> None:
        if self.server is not None:
            self.server.end()
            self.server = None

    def close(self) -> None:
        """End the server, the client and the other machine."""
        for one in (self.client, self.machine):
            if one is not None:
                one.end()
        self._end_server()
        self.client = self.machine = None


def _free_port() -> int:
    """Return a port below those that the system gives to connections."""
    for port in _ports:
        with suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port
    raise OSError("no port is free")
