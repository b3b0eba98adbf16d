"""How a process that serves has its collector of cycles look at what lives."""

from __future__ import annotations

import gc
import subprocess
import sys
from pathlib import Path

from tests.processes import run_python

from uoarm.server._running import _short_collections
from uoarm.testing import patience

ROOT = Path(__file__).parents[2]


class Node:
    """Part of a circle."""

    def __init__(self) -> None:
        self.other: Node = self


def count() -> int:
    return sum(isinstance(value, Node) for value in gc.get_objects())


def look_again_and_again() -> None:
    """Run alone: what the tests have loaded would be looked at twenty times, too."""
    former = gc.get_threshold()
    with _short_collections():
        kept = [Node() for _ in range(1000)]
        gc.collect()
        assert gc.get_freeze_count() > len(kept)
        assert not count()
        kept.clear()
        looks = 0
        while gc.get_freeze_count():
            gc.collect()
            looks += 1
            assert looks < 20
        assert count() == 1000
        gc.collect()
        assert not count()
    assert gc.get_threshold() == former
    assert not gc.get_freeze_count()


def test_what_outlived_a_look_is_left_out_of_the_next_ones_and_freed_in_the_end() -> None:
    code = f"from {__name__} import look_again_and_again; look_again_and_again()"
    subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, timeout=patience())


def test_what_an_application_has_frozen_stays_so() -> None:
    kept: list[object] = []
    gc.freeze()
    with _short_collections():
        pass
    # Not a count of what is frozen: that gets less where a thread of another test ends meanwhile.
    found = gc.get_objects()  # but what is frozen
    assert not any(item is kept for item in found)


INTERRUPTED = """
import ctypes, gc, weakref
from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import ServerOptions, run

class InterruptingReference(weakref.ref):
    _as_parameter_ = 2

class Node:
    pass

gc.disable()
node = Node()
node.node = node
reference = InterruptingReference(node, ctypes.CDLL(None)["raise"])
del node
with RobotManager(loads("version: 1\\nbridges: {}\\nfunctions: {}")) as robot:
    run(robot, ServerOptions(port=0))
"""


def test_ctrl_c_while_everything_is_looked_at_ends_the_server() -> None:
    """The signal comes within the collector, whose callback is the next thing that Python calls."""
    done = run_python("-c", INTERRUPTED)
    assert (done.returncode, done.stderr) == (0, "")
