"""What becomes of a hosted bridge when its host is harmed: noticed, counted, and cleaned up."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.host import hosted
from tests.host.hosted import ANY, Events, at
from tests.processes import lives, states

from uoarm._host import RemoteBridge
from uoarm._host.transport.liveness import Heartbeat
from uoarm.bridge import Capabilities, Channel, HealthEvent
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Health, Role
from uoarm.testing import ResourceSnapshot, patience, slowness, wait

pytestmark = pytest.mark.usefixtures("nothing_is_left")


def _lost(events: Events) -> list[str]:
    return [event.cause for event in events.all if event.health is Health.LOST]


def _harmed(folder: Path, harm: Callable[[RemoteBridge], object], says: str) -> RemoteBridge:
    """Have traffic both ways, harm the host, and hold that its death is reported once."""
    bridge = hosted.bridge(folder)
    process, events = bridge.process, Events()
    bridge.watch(events)
    got: list[int] = []
    bridge.open_source(at("forever"), ANY, got.append)
    sink = bridge.open_sink(at("echo", Role.INPUT), ANY)
    wait(lambda: len(got) > 10)
    harm(bridge)
    wait(lambda: _lost(events))
    assert len(_lost(events)) == 1
    assert says in _lost(events)[0]
    assert got == list(range(len(got)))
    with pytest.raises(BridgeError, match="died"):
        sink.send(1)
    with pytest.raises(BridgeError, match="is dead") as caught:
        bridge.describe(at("echo"))
    assert caught.value.reason is FailureReason.UNAVAILABLE
    bridge.close()
    wait(lambda: not lives(process))
    return bridge


def test_a_killed_host_is_noticed_at_once(tmp_path: Path) -> None:
    _harmed(tmp_path, lambda far: os.kill(far.process, signal.SIGKILL), "killed by SIGKILL")


def test_a_host_that_ends_by_itself_is_noticed_at_once(tmp_path: Path) -> None:
    def end(far: RemoteBridge) -> None:
        with pytest.raises(BridgeError, match="ended with status 9"):
            far.call(at("die", Role.SERVICE), 9)

    _harmed(tmp_path, end, "ended with status 9")


def test_a_stopped_host_is_given_up_after_its_silence(tmp_path: Path) -> None:
    def stop(far: RemoteBridge) -> None:
        os.kill(far.process, signal.SIGSTOP)
        hosted.hasten(far, 0.5)

    _harmed(tmp_path, stop, "has not answered")


def test_a_host_that_is_given_up_is_gone_before_it_is_reported(tmp_path: Path) -> None:
    """What it took after its losses were counted would be counted twice."""
    bridge = hosted.bridge(tmp_path)
    lived: list[bool] = []

    def take(event: HealthEvent) -> None:
        if event.health is Health.LOST:
            lived.append(lives(bridge.process))

    bridge.watch(take)
    os.kill(bridge.process, signal.SIGSTOP)
    hosted.hasten(bridge, 0.5)
    wait(lambda: lived)
    bridge.close()
    assert lived == [False]


def test_a_host_that_hangs_with_the_interpreter_lock_is_given_up(tmp_path: Path) -> None:
    def hang(far: RemoteBridge) -> None:
        hosted.hasten(far, slowness())
        with pytest.raises(BridgeError, match="has not answered"):
            far.call(at("hang", Role.SERVICE), 100_000, timeout=patience())

    _harmed(tmp_path, hang, "has not answered")


def test_a_host_that_is_stopped_for_a_moment_goes_on_and_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hosted.doubt_soon(monkeypatch)
    bridge = hosted.bridge(tmp_path)
    events, got = Events(), list[int]()
    bridge.watch(events)
    channel = bridge.open_source(at("forever"), ANY, got.append)
    wait(lambda: len(got) > 10)
    os.kill(bridge.process, signal.SIGSTOP)
    wait(lambda: events.all)
    assert events.all[0].health is Health.DEGRADED
    os.kill(bridge.process, signal.SIGCONT)
    before = len(got)
    wait(lambda: len(events.all) >= 2)
    assert events.all[1].health is Health.OK
    wait(lambda: len(got) > before + 10)
    assert got == list(range(len(got)))
    assert channel.facts()["lost_on_link"] == 0
    bridge.close()


def test_a_host_that_answers_again_covers_up_nothing_that_its_bridge_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hosted.doubt_soon(monkeypatch)
    bridge = hosted.bridge(tmp_path)
    events = Events()
    bridge.watch(events)
    assert bridge.call(at("ail", Role.SERVICE), True)
    wait(lambda: len(events.all) == 1)
    os.kill(bridge.process, signal.SIGSTOP)
    wait(lambda: len(events.all) == 2)
    os.kill(bridge.process, signal.SIGCONT)
    wait(lambda: len(events.all) == 3)
    assert not bridge.call(at("ail", Role.SERVICE), False)
    wait(lambda: len(events.all) == 4)
    ails, unanswered, again, well = ((event.health, event.cause) for event in events.all)
    assert ails == again == (Health.DEGRADED, "it ails")
    assert unanswered[0] is Health.DEGRADED
    assert well == (Health.OK, "it is well")
    bridge.close()


def test_what_a_bridge_judges_of_a_component_comes_with_its_name(tmp_path: Path) -> None:
    bridge = hosted.bridge(tmp_path)
    events = Events()
    bridge.watch(events)
    assert bridge.call(at("run_low", Role.SERVICE), True)
    wait(lambda: events.all)
    assert (events.all[0].component, events.all[0].about) == ("thing", "battery")
    bridge.close()


OPENED: dict[str, Callable[[RemoteBridge], Channel | None]] = {
    "source": lambda bridge: bridge.open_source(at("forever"), ANY, lambda _: None),
    "sink": lambda bridge: bridge.open_sink(at("refuse", Role.INPUT), ANY),
    "service": lambda bridge: bridge.serve(at("double", Role.SERVICE), lambda _: 0),
    "link": lambda bridge: bridge.link(at("forever"), at("refuse", Role.INPUT)),
}


@pytest.mark.parametrize("what", OPENED)
def test_what_reports_while_it_opens_is_that_channel(what: str, tmp_path: Path) -> None:
    bridge = hosted.bridge(tmp_path)
    bridge.capabilities = Capabilities(call=True, serve=True, link=True)
    events = Events()
    bridge.watch(events)
    assert bridge.call(at("limp", Role.SERVICE), 1)
    channel = OPENED[what](bridge)
    assert channel is not None
    wait(lambda: events.all)
    assert [(event.channel, event.cause) for event in events.all] == [(channel, "it limps")]
    channel.close()
    bridge.call(at("limp", Role.SERVICE), 0)
    bridge.call(at("ail", Role.SERVICE), True)
    wait(lambda: events.all[1:])
    assert events.all[1].cause == "it ails", "what is closed is no news"
    bridge.close()


def test_a_storm_of_exceptions_kills_nothing_and_every_one_is_counted(tmp_path: Path) -> None:
    bridge = hosted.bridge(tmp_path)
    sink = bridge.open_sink(at("refuse", Role.INPUT), ANY)
    for number in range(5000):
        sink.send(number)
    assert sink.drain(patience())
    wait(lambda: sink.facts()["failed_in_host"] == 5000)
    assert bridge.call(at("double", Role.SERVICE), 1) == 2
    bridge.close()


def test_a_host_that_prints_more_than_a_pipe_holds_goes_on(tmp_path: Path) -> None:
    bridge = hosted.bridge(tmp_path)
    assert bridge.call(at("shout", Role.SERVICE), 30, timeout=patience()) == 30
    bridge.close()


def test_messages_under_way_at_a_death_are_counted(tmp_path: Path) -> None:
    bridge = hosted.bridge(tmp_path)
    sink = bridge.open_sink(at("never", Role.INPUT), ANY)
    for number in range(40):
        sink.send(number)
    os.kill(bridge.process, signal.SIGKILL)
    sent = 40
    while not _refused(lambda: sink.send(0)):
        sent += 1
    assert sink.facts()["under_way"] == sent
    bridge.close()


def _refused(action: Callable[[], object]) -> bool:
    try:
        action()
    except BridgeError:
        return True
    return False


def test_a_kill_while_a_channel_opens_fails_the_opening(tmp_path: Path) -> None:
    bridge = hosted.bridge(tmp_path)
    failures: list[BridgeError] = []

    def open_it() -> None:
        try:
            bridge.open_source(at("takes_long"), ANY, lambda _: None, timeout=patience())
        except BridgeError as error:
            failures.append(error)

    opening = threading.Thread(target=open_it)
    opening.start()
    wait((tmp_path / "begun").exists)
    os.kill(bridge.process, signal.SIGKILL)
    opening.join(patience())
    assert not opening.is_alive()
    assert "SIGKILL" in str(failures[0])
    assert bridge.open_channels == 0
    bridge.close()


def test_a_kill_while_the_host_starts_fails_the_start(tmp_path: Path) -> None:
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\nkill -KILL $$\n")
    python.chmod(0o755)
    with pytest.raises(BridgeError, match="killed by SIGKILL"):
        hosted.bridge(tmp_path, python=str(python))


def test_a_host_that_gets_no_heartbeat_is_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: Heartbeat) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(Heartbeat, "start", refuse)
    with pytest.raises(RuntimeError, match="new thread"):
        hosted.bridge(tmp_path)


def test_a_host_for_which_there_is_no_thread_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whichever of its threads it is: the one that reads what it prints begins after the host."""
    starts, names = threading.Thread.start, list[str]()

    def start(thread: threading.Thread) -> None:
        if thread.name.endswith("-far") and thread.name not in names:
            names.append(thread.name)
            raise RuntimeError("can't start new thread")
        starts(thread)

    monkeypatch.setattr(threading.Thread, "start", start)
    before = ResourceSnapshot()
    failures = 0
    while True:
        try:
            bridge = hosted.bridge(tmp_path)
        except (BridgeError, RuntimeError) as error:
            assert "can't start new thread" in str(error)
            failures += 1
            before.check(patience())
        else:
            bridge.close()
            break
    kinds = ("watch", "flows", "link", "host", "log", "heartbeat")
    assert names == [f"uoarm-{kind}-far" for kind in kinds]
    assert failures == len(kinds)


def test_a_kill_while_it_closes_does_not_stop_the_closing(tmp_path: Path) -> None:
    bridge = hosted.bridge(tmp_path)
    process = bridge.process
    bridge.open_source(at("forever"), ANY, lambda _: None)
    closing = threading.Thread(target=lambda: _refused(bridge.close))
    closing.start()
    os.kill(process, signal.SIGKILL)
    closing.join(patience())
    assert not closing.is_alive()
    assert not lives(process)


def test_a_component_that_never_ends_cannot_keep_its_host_alive(tmp_path: Path) -> None:
    bridge = hosted.bridge(tmp_path)
    process = bridge.process
    busy = threading.Thread(
        target=lambda: _refused(
            lambda: bridge.call(at("hang", Role.SERVICE), 100_000, timeout=patience())
        )
    )
    busy.start()
    wait(lambda: states(process)[:1] == ["S"])  # as the main thread does in a call that hangs
    _refused(bridge.close)
    wait(lambda: not lives(process))
    busy.join(patience())
    assert not busy.is_alive()


APPLICATION = """
    import os, signal, sys
    from pathlib import Path
    from tests.host import hosted
    from tests.host.hosted import ANY, at
    bridge = hosted.bridge(Path(sys.argv[1]))
    bridge.open_source(at("forever"), ANY, lambda message: None)
    print(bridge.process, flush=True)
    {end}
"""


@pytest.mark.parametrize(
    "end",
    [
        "sys.exit(0)",
        "raise RuntimeError('the application fails')",
        "os._exit(1)",
        "os.kill(os.getpid(), signal.SIGKILL)",
        "bridge.open_source(at('count'), ANY, lambda message: os.abort()); signal.pause()",
    ],
    ids=["exit", "exception", "hard exit", "SIGKILL", "crash in a callback"],
)
def test_a_host_ends_with_its_application(end: str, tmp_path: Path) -> None:
    code = textwrap.dedent(APPLICATION).format(end=end)
    with subprocess.Popen(
        [sys.executable, "-c", code, str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        cwd=Path(__file__).parents[2],
    ) as application:
        assert application.stdout is not None
        host = int(application.stdout.readline())
        application.wait(patience())
    wait(lambda: not lives(host))
