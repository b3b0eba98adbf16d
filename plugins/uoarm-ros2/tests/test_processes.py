"""Several bridges beside an application's own rclpy, and nothing left behind."""

from __future__ import annotations

import faulthandler
import os
import signal
import subprocess
import sys
import threading
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from endpoints import INT64, Make, Start, await_quiet_watch, endpoint, sink, source
from peers import DOMAIN
from tests.inbox import Inbox  # type: ignore[import-not-found]
from tests.processes import run_python  # type: ignore[import-not-found]
from uoarm_ros2._middleware import _loop
from uoarm_ros2._middleware._wait_set import WaitSet

from uoarm.bridge import Sink
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Role
from uoarm.testing import Background, ResourceSnapshot, patience, wait


def test_domains_do_not_meet(make_bridge: Make, peer: Start) -> None:
    near, far = make_bridge("near"), make_bridge("far", domain_id=DOMAIN + 1)
    talkers = peer("talker"), peer("talker", ROS_DOMAIN_ID=str(DOMAIN + 1))
    inboxes = Inbox(), Inbox()
    for bridge, talker, inbox in zip((near, far), talkers, inboxes, strict=True):
        talker.do("advertise", topic="/numbers")
        source(bridge, endpoint(Role.OUTPUT, "/numbers", INT64), inbox)
    talkers[0].do("publish", topic="/numbers", count=3)
    talkers[1].do("publish", topic="/numbers", count=2, first=100)
    inboxes[0].wait_for(3)
    inboxes[1].wait_for(2)
    assert inboxes[0].numbers() == [1, 2, 3]
    assert inboxes[1].numbers() == [100, 101]


HOST = """
import rclpy, signal
from rclpy.node import Node
from std_msgs.msg import Int64
from uoarm.bridge import Registry
from uoarm.model import BridgeSpec, Endpoint, Role

rclpy.init(args=[])
handler = signal.getsignal(signal.SIGINT)
node = Node("application")
seen = []
node.create_subscription(Int64, "/numbers", lambda message: seen.append(message.data), 10)
bridge = Registry().create(BridgeSpec("ros", "ros2", {}))
assert signal.getsignal(signal.SIGINT) is handler
at = Endpoint("ros", "c", Role.INPUT, ("/numbers", "std_msgs/msg/Int64"))
sink = bridge.open_sink(at, bridge.describe(at).message)
sink.send({"data": 1})
while not seen:
    rclpy.spin_once(node, timeout_sec=0.1)
bridge.close()
assert rclpy.ok()
publisher = node.create_publisher(Int64, "/numbers", 10)
while len(seen) < 2:
    publisher.publish(Int64(data=2))
    rclpy.spin_once(node, timeout_sec=0.1)
rclpy.shutdown()
print(seen[:2])
"""


def test_an_application_keeps_its_own_rclpy(tmp_path: Path) -> None:
    script = tmp_path / "application.py"
    script.write_text(HOST)
    done = run_python(script)
    assert (done.stdout.strip(), done.returncode) == ("[1, 2]", 0), done.stderr


INTERRUPTED_LATER = """
import signal, sys, threading, time
import rclpy
from uoarm import RobotManager
from uoarm.config import loads
from uoarm.server import ServerOptions, run

rclpy.init(args=[])
with RobotManager(loads(sys.argv[1])) as manager:
    if sys.argv[2] == "request":
        manager.request("show").kill()
    else:
        end = threading.Thread(target=signal.raise_signal, args=(signal.SIGTERM,))
        run(manager, ServerOptions(port=0), ready=lambda server: end.start())
    assert rclpy.ok()
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        while rclpy.ok():  # its handler ends the contexts in a thread of its own
            time.sleep(0.01)
        print("ended")
"""
SHOWING = """
version: 1
bridges: {ros: {plugin: ros2}}
functions:
  show:
    components:
      - name: screen
        bridge: ros
        input:
          endpoint: [/shown, std_msgs/msg/Int64]
          options: {peer: optional, wait: 0}
"""


@pytest.mark.parametrize("what", ["request", "run"])
def test_a_signal_ends_the_contexts_of_an_application_afterwards(tmp_path: Path, what: str) -> None:
    script = tmp_path / "application.py"
    script.write_text(INTERRUPTED_LATER)
    done = run_python(script, SHOWING, what)
    assert (done.stdout, done.returncode) == ("ended\n", 0), done.stderr


LEFT_OPEN = """
import sys, threading
from std_msgs.msg import Int64
from uoarm.bridge import Registry
from uoarm.model import BridgeSpec, Endpoint, Role

bridge = Registry().create(BridgeSpec("ros", "ros2", {}))
options = {"peer": "optional", "wait": 0.0}
into = Endpoint("ros", "c", Role.INPUT, ("/left", "std_msgs/msg/Int64"), options=options)
sink = bridge.open_sink(into, bridge.describe(into).message)
out = Endpoint("ros", "c", Role.OUTPUT, ("/left", "std_msgs/msg/Int64"))
came = threading.Event()
source = bridge.open_source(out, bridge.describe(out).message, lambda _: came.set())
sink.send({"data": 1})
came.wait()
if sys.argv[1] == "raises":
    raise SystemExit(3)
"""


FORKED = f"""{LEFT_OPEN.partition("if sys")[0]}
import os
pid = os.fork()
if pid == 0:
    if sys.argv[1] == "closes":
        source.close()
        bridge.close()
    sys.exit(3)
_, status = os.waitpid(pid, 0)
came.clear()
sink.send({{"data": 2}})
came.wait()
print("child", os.waitstatus_to_exitcode(status))
"""


@pytest.mark.parametrize("how", ["ends", "closes"])
def test_a_child_that_is_forked_ends_nothing_of_its_parent(tmp_path: Path, how: str) -> None:
    script = tmp_path / "forked.py"
    script.write_text(FORKED)
    done = run_python(script, how)
    # Fast DDS itself may crash as a child's interpreter ends, with bare rclpy, too.
    assert done.stdout.startswith("child "), done.stderr
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(("how", "code"), [("returns", 0), ("raises", 3)])
def test_a_process_that_ends_without_close_ends_as_it_wants(
    tmp_path: Path, how: str, code: int
) -> None:
    script = tmp_path / "left_open.py"
    script.write_text(LEFT_OPEN)
    done = run_python(script, how)
    assert (done.returncode, done.stderr) == (code, "")


INTERRUPTED = """
import os, signal, sys, time
import rclpy
from rclpy.signals import SignalHandlerOptions
from uoarm.bridge import Registry
from uoarm.model import BridgeSpec, Endpoint, Role

if sys.argv[1] == "beside rclpy without its handlers":
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
elif sys.argv[1] == "beside rclpy":
    rclpy.init(args=[])
bridge = Registry().create(BridgeSpec("ros", "ros2", {}))
into = Endpoint("ros", "c", Role.INPUT, ("/stop", "std_msgs/msg/Int64"), options={"wait": 60})
sink = bridge.open_sink(into, bridge.describe(into).message)
try:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(60)
except KeyboardInterrupt:
    if sys.argv[1] == "beside rclpy":
        while rclpy.ok():  # its handler ends the contexts in a thread of its own
            time.sleep(0.01)
    sink.send({"data": 0})
    print("sent", flush=True)
    sys.stdin.read()  # until it has arrived
    bridge.close()
"""


@pytest.mark.parametrize("how", ["alone", "beside rclpy without its handlers", "beside rclpy"])
def test_a_last_message_can_be_sent_after_an_interrupt(
    tmp_path: Path, peer: Start, how: str
) -> None:
    listener = peer("listener")
    listener.do("subscribe", topic="/stop")
    script = tmp_path / "interrupted.py"
    script.write_text(INTERRUPTED)
    with subprocess.Popen(
        [sys.executable, str(script), how],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            seen = listener.do("report", topic="/stop", expected=1)
            said = process.communicate("", timeout=patience())
        finally:
            process.kill()
    assert (seen, *said, process.returncode) == ([0], "sent\n", "", 0)


def test_making_a_bridge_changes_nothing_global(make_bridge: Make) -> None:
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)
    was_enabled = faulthandler.is_enabled()
    make_bridge()
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGTERM)) == before
    assert faulthandler.is_enabled() == was_enabled


def _resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def test_five_hundred_openings_leave_nothing_behind(make_bridge: Make) -> None:
    bridge = make_bridge(settle=0)
    at = endpoint(Role.INPUT, "/again", INT64, peer="optional", wait=0.0)
    from_there = endpoint(Role.OUTPUT, "/again", INT64, peer="optional", wait=0.0)

    def cycle() -> None:
        out = sink(bridge, at)
        into = source(bridge, from_there, lambda _: None)
        out.send({"data": 1})
        into.close()
        out.close()

    for _ in range(50):
        cycle()
    await_quiet_watch(sink(bridge, at))
    snapshot, memory = ResourceSnapshot(), _resident()
    for _ in range(500):
        cycle()
    assert bridge.open_channels == 0
    snapshot.check()
    assert _resident() - memory < 500 * 8_000


def test_wait_sets_are_built_only_when_something_comes_or_goes(
    make_bridge: Make, peer: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    built: list[int] = []
    init = WaitSet.__init__

    def count(self: WaitSet, context: Any, guard: Any, entities: Any) -> None:
        built.append(len(tuple(entities)))
        init(self, context, guard, entities)

    monkeypatch.setattr(WaitSet, "__init__", count)
    monkeypatch.setattr(_loop, "_FEW", 100)  # who falls silent would be waited for apart
    bridge, talker, inbox = make_bridge(), peer("talker"), Inbox()
    for number in range(20):
        idle = endpoint(Role.OUTPUT, f"/idle_{number}", INT64, peer="optional", wait=0.0)
        source(bridge, idle, print)
    talker.do("advertise", topic="/busy", history="keep_all")
    at = endpoint(Role.OUTPUT, "/busy", INT64, qos={"history": "keep_all"})
    channel = source(bridge, at, inbox)
    talker.do("publish", topic="/busy", count=10)
    inbox.wait_for(10)
    before = len(built)
    talker.do("publish", topic="/busy", count=1000, first=11)
    inbox.wait_for(1010)
    assert inbox.numbers() == list(range(1, 1011))
    assert len(built) == before
    channel.close()
    wait(lambda: len(built) == before + 2)


def test_bridges_come_and_go_without_a_trace(make_bridge: Make) -> None:
    make_bridge("first").close()
    snapshot = ResourceSnapshot()
    for number in range(50):
        bridge = make_bridge(f"number_{number}")
        sink(bridge, endpoint(Role.INPUT, "/x", INT64, peer="optional", wait=0.0))
        bridge.close()
    snapshot.check()


def test_a_bridge_closes_in_time_while_messages_flow_both_ways(
    make_bridge: Make, peer: Start
) -> None:
    talker = peer("talker")
    talker.do("advertise", topic="/flood")
    out = endpoint(Role.INPUT, "/out", INT64, peer="optional", wait=0.0)
    for number in range(5):
        bridge, inbox = make_bridge(f"number_{number}"), Inbox()
        source(bridge, endpoint(Role.OUTPUT, "/flood", INT64), inbox)
        sending = Background(partial(send_until_closed, sink(bridge, out)))
        talker.start("publish", topic="/flood", count=500, period=0.001)
        inbox.wait_for(10)
        Background(bridge.close).result()
        assert sending.result() is FailureReason.CLOSED
        talker.receive()
    assert [thread.name for thread in threading.enumerate() if thread.name.startswith("ros2")] == []


def send_until_closed(out: Sink) -> FailureReason:
    while True:
        try:
            out.send({"data": 1})
        except BridgeError as error:
            return error.reason


@pytest.mark.parametrize("option", [{"domain_id": -1}, {"domain": 3}, {"executor": "events"}])
def test_the_options_schema_refuses(option: dict[str, object]) -> None:
    from jsonschema import Draft202012Validator
    from uoarm_ros2 import uoarm_bridge_types

    schema = uoarm_bridge_types()[0].options_schema
    assert not isinstance(schema, bool)
    Draft202012Validator.check_schema(schema)
    assert not Draft202012Validator(dict(schema)).is_valid(option)
