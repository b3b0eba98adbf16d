"""The bridge against a node of roscpp, compiled from the source beside this file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from endpoints import bridge_to, input_, output, service
from peers import HERE, Master, Peer, compiler
from tests.inbox import Inbox  # type: ignore[import-not-found]
from tests.processes import run_program  # type: ignore[import-not-found]

from uoarm.errors import BridgeError
from uoarm.model import Health, MessageStructure
from uoarm.testing import Collector, patience, same

ANY = MessageStructure(True)


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The node, compiled."""
    path = tmp_path_factory.mktemp("roscpp") / "node"
    found = run_program("pkg-config", "--cflags", "--libs", "roscpp", "actionlib", check=True)
    flags = found.stdout.split()
    words = [str(compiler()), "-O0", "-o", str(path), str(HERE / "roscpp_node.cpp"), *flags]
    words += ["-lactionlib", "-lboost_thread", "-lpthread"]
    done = run_program(*words)
    assert done.returncode == 0, done.stderr[-4000:]
    return path


@pytest.fixture(scope="module")
def cpp(master: Master, program: Path) -> Iterator[Peer]:
    peer = master.program(str(program))
    yield peer
    peer.kill()


def test_a_latched_message_of_roscpp_comes_first(master: Master, cpp: Peer) -> None:
    with bridge_to(master) as bridge:
        at, collector = output("/cpp/latched", wait=patience()), Collector()
        message: Any = bridge.describe(at).message
        assert message.native_type == "std_msgs/String"
        source = bridge.open_source(at, message, collector.deliver)
        assert collector.wait(1) == [{"data": "of roscpp"}]
        assert source.latched


def test_arrays_pass_there_and_back_in_order(master: Master, cpp: Peer) -> None:
    with bridge_to(master) as bridge:
        collector = Collector()
        # A subscriber of roscpp sends no definition: the type is known of Noetic's own packages.
        assert bridge.describe(input_("/cpp/in")).message is not None
        bridge.open_source(output("/cpp/out"), ANY, collector.deliver)
        sink = bridge.open_sink(input_("/cpp/in", wait=patience()), ANY)
        layout = {"dim": [{"label": "x", "size": 3, "stride": 3}], "data_offset": 0}
        sent = [{"layout": layout, "data": [0.5 * number, -1.0, 1e300]} for number in range(200)]
        for message in sent:
            sink.send(message)
        assert same(collector.wait(200), sent)


def test_services_pass_both_ways(master: Master, cpp: Peer) -> None:
    with bridge_to(master) as bridge:
        reply = bridge.call(service("/cpp/loggers"), {})
        assert reply["loggers"][1] == {"name": "second", "level": "of roscpp"}
        bridge.serve(
            service("/ours/loggers", "roscpp/GetLoggers"),
            lambda _: {"loggers": [{"name": "of uoarm", "level": ""}]},
        )
        assert cpp.do("call") == "of uoarm"


def test_actions_pass_both_ways(master: Master, cpp: Peer) -> None:
    with bridge_to(master) as bridge:
        at = service("/cpp/add")
        assert bridge.call(at, {"a": 40, "b": 2}) == {"sum": 42}
        bridge.serve(
            service("/ours/add", "actionlib/TwoIntsAction"),
            lambda goal: {"sum": goal["a"] + goal["b"]},
        )
        assert cpp.do("goal") == ["SUCCEEDED", 42]


def test_the_death_of_a_node_of_roscpp_is_noticed(master: Master, program: Path) -> None:
    peer = master.program(str(program), "__name:=mortal_cpp")
    with bridge_to(master) as bridge:
        reports = Inbox(bridge)
        at = output("/cpp/latched", node="/mortal_cpp", wait=patience())
        bridge.open_source(at, ANY, Collector().deliver)
        peer.kill()
        assert "/mortal_cpp" in reports.event(Health.LOST).cause
        with pytest.raises(BridgeError, match="/mortal_cpp"):
            bridge.describe(at)
