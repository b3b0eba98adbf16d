"""A machine behind a router that translates addresses: real namespaces, processes and TLS."""

from __future__ import annotations

import json
import queue
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest
from tests.host.joined import Joined, robot
from tests.nat import OUTSIDE, Nat, nat
from typing_extensions import Self

from uoarm.testing import patience, slowness, wait

MANAGER = Path(__file__).parent / "manager_apart.py"
PORT = 7447
SILENCE = 10 * slowness()  # no end is starved for so long before the router forgets


@pytest.fixture
def router() -> Iterator[Nat]:
    with nat() as made:
        yield made


class ManagerApart:
    """A manager outside, ended with the block."""

    def __init__(self, router: Nat, file: Path) -> None:
        self._process = subprocess.Popen(
            [*router.outside, sys.executable, str(MANAGER), str(file)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._lines: queue.Queue[str] = queue.Queue()
        self._reading = threading.Thread(target=self._read, daemon=True)
        self._reading.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as stream:
            for line in stream:
                self._lines.put(line)

    def ask(self, question: str) -> Any:
        assert self._process.stdin is not None
        self._process.stdin.write(f"{question}\n")
        self._process.stdin.flush()
        return json.loads(self._lines.get(timeout=2 * patience()))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is not None:
            self._process.kill()
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(patience())
        self._reading.join(patience())


def test_a_machine_behind_nat_is_used_and_comes_back_when_the_router_forgets_it(
    tmp_path: Path, router: Nat
) -> None:
    file = robot(
        tmp_path, PORT, address=OUTSIDE, spare=True, failover="{return_after: 0.2}", silence=SILENCE
    )
    place, silence = f"tls/{OUTSIDE}:{PORT}", ["--silence", str(SILENCE)]
    with (
        Joined(tmp_path, place, *silence, within=router.inside) as host,
        ManagerApart(router, file) as manager,
    ):
        assert manager.ask("call") > 0
        assert manager.ask("doubled")[-1] == 1998  # each number came from there and went back
        assert manager.ask("tick") >= 0  # the queue may have dropped the first ones by now
        router.renumber()
        wait(lambda: manager.ask("gaps"), "the lost link was not noticed")
        assert manager.ask("gaps")[0][1:] == ["spare"]
        assert "machine 'arm'" in manager.ask("gaps")[0][0]
        wait(lambda: "bridge far is let go" in host.log)
        wait(lambda: manager.ask("gaps")[1:], "it did not join again")
        assert manager.ask("gaps")[1][1:] == ["ticker"]
        assert manager.ask("present")
        assert manager.ask("call") > 0
