"""A ROS master, and nodes that know nothing of uoarm, in processes of their own on loopback."""

from __future__ import annotations

import os
import random
import shutil
import socket
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tests.processes import AnsweringProgram  # type: ignore[import-not-found]

from uoarm.testing import wait

ROS_PYTHON = "/usr/bin/python3"  # what Debian installs belongs to it alone
HERE = Path(__file__).parent
MASTER = "/usr/bin/rosmaster"


class Master:
    """rosmaster in a process of its own, on a loopback address that no other process chooses.

    An address and not only a port: it can be killed, and comes back at the same place.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir(exist_ok=True)
        self.host = "127." + ".".join(str(random.randint(1, 254)) for _ in range(3))
        self.port = 11311
        self._process: subprocess.Popen[bytes] | None = None
        self._peers: list[Peer] = []

    @property
    def uri(self) -> str:
        return f"http://{self.host}:{self.port}"

    @property
    def environment(self) -> dict[str, str]:
        keep = {"PATH": os.environ.get("PATH", ""), "LANG": "C.UTF-8"}
        ros = {"ROS_MASTER_URI": self.uri, "ROS_IP": self.host, "ROS_HOME": str(self.folder)}
        return {**keep, **ros, "HOME": str(self.folder), "PYTHONUNBUFFERED": "1"}

    def start(self) -> None:
        with (self.folder / "master.log").open("ab") as log:
            self._process = subprocess.Popen(
                [MASTER, "--core", "-p", str(self.port)],
                stdout=log,
                stderr=log,
                env=self.environment,
            )
        wait(self._answers, "the master does not answer")

    def kill(self) -> None:
        """End it without a word, as a loss of power does."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def end(self) -> None:
        """End its process."""
        self.kill()

    def send_signal(self, number: int) -> None:
        assert self._process is not None
        self._process.send_signal(number)

    def peer(self, name: str, *remaps: str) -> Peer:
        words = [ROS_PYTHON, str(HERE / "debian" / "peer_node.py"), name, *remaps]
        self._peers.append(Peer(self, words))
        return self._peers[-1]

    def program(self, *words: str) -> Peer:
        # What listens on loopback alone does so on its first address in roscpp.
        self._peers.append(Peer(self, [*words], ROS_IP="127.0.0.1"))
        return self._peers[-1]

    def end_peers(self) -> None:
        for peer in self._peers:
            peer.kill()
        self._peers.clear()

    def _answers(self) -> bool:
        assert self._process is not None
        log = (self.folder / "master.log").read_text(encoding="utf-8", errors="replace")
        assert self._process.poll() is None, log
        return self._listens()

    def _listens(self) -> bool:
        try:
            socket.create_connection((self.host, self.port), 1).close()
        except OSError:
            return False
        return True


class RestartingMaster(Master):
    """One that is killed and started again within its process, whose number stays."""

    def start(self) -> None:
        if self._process is None:
            self._process = subprocess.Popen(
                [ROS_PYTHON, str(HERE / "debian" / "restarting_master.py"), str(self.port)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env=self.environment,
            )
        self._do(b"start")

    def kill(self) -> None:
        self._do(b"stop")
        # Its thread, which waits for a socket that is closed, has the port for half a second still.
        wait(lambda: not self._listens(), "the master keeps its port")

    def end(self) -> None:
        assert self._process is not None
        self._process.kill()
        self._process.communicate()

    def _do(self, command: bytes) -> None:
        assert self._process is not None
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        stdin.write(command + b"\n")
        stdin.flush()
        assert stdout.readline() == command + b"\n"


class Peer(AnsweringProgram):  # type: ignore[misc]  # the harness is not on its path
    """A node in a process of its own, which does what it is asked."""

    def __init__(self, master: Master, words: list[str], **environment: str) -> None:
        self._log = master.folder / "peers.log"
        variables = {**master.environment, **environment}
        with self._log.open("ab") as errors:
            super().__init__(*words, environment=variables, errors=errors)

    def receive(self) -> Any:
        try:
            return super().receive()
        except AssertionError as error:
            raise AssertionError(self._log.read_text(errors="replace")[-4000:]) from error

    def publish(self, topic: str, **given: Any) -> None:
        """Publish to a subscriber that this node knows: it learns of one after that has opened."""
        self.wait_for("connections", bool, topic=topic)
        self.do("publish", topic=topic, **given)

    def wait_for(self, command: str, fits: Callable[[Any], bool], **given: Any) -> Any:
        seen: list[Any] = [None]

        def has_come() -> bool:
            seen[0] = self.do(command, **given)
            return fits(seen[0])

        wait(has_come, lambda: f"{command} {given}: what came last was {seen}")
        return seen[0]


@contextmanager
def running(folder: Path, kind: type[Master] = Master) -> Iterator[Master]:
    """A master while a block runs."""
    master = kind(folder)
    master.start()
    try:
        yield master
    finally:
        master.end_peers()
        master.end()


def compiler() -> str | None:
    return shutil.which("g++")
