"""Real engines make real sound of text; what is missing is said with what to install."""

from __future__ import annotations

import io
import shutil
import stat
import struct
import sys
import threading
import wave
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from lines import LIMIT
from rigs import bridged, endpoint
from tests.processes import run_python  # type: ignore[import-not-found]
from uoarm_rocos import speech as speech_module
from uoarm_rocos._options import DeviceOptions
from uoarm_rocos.speech import (
    Engine,
    EspeakEngine,
    FestivalEngine,
    Sound,
    Speech,
)

from uoarm._control import RobotManager
from uoarm.bridge import ServiceStructures
from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason, MessageError
from uoarm.testing import Background, patience

SAY = endpoint("voice", "speechGeneration", "service")
TEXT = "Your pulse is seventy two, and your blood pressure is normal."
NEEDS_FESTIVAL = pytest.mark.needs("festival")


def loudness(audio: bytes) -> tuple[float, float]:
    """Return the root mean square of a WAV file and its duration."""
    with wave.open(io.BytesIO(audio)) as reader:
        count = reader.getnframes()
        samples = struct.unpack(f"<{count}h", reader.readframes(count))
        mean = (sum(sample * sample for sample in samples) / count) ** 0.5
        return mean, count / reader.getframerate()


@pytest.mark.parametrize("driver", ["espeak", pytest.param("festival", marks=NEEDS_FESTIVAL)])
def test_text_becomes_sound_in_a_file_where_there_is_no_audio_device(
    driver: str, tmp_path: Path
) -> None:
    options: dict[str, object] = {"driver": driver, "directory": str(tmp_path), "play": "never"}
    with bridged(voice=options) as (bridge, _):
        reply = bridge.call(SAY, {"text": TEXT}, timeout=LIMIT)
        mean, duration = loudness(reply["audio"])
        assert mean > 300
        assert duration == pytest.approx(reply["duration"])
        assert 2.0 < duration < 8.0
        assert reply["played"] is False
        assert Path(reply["file"]).read_bytes() == reply["audio"]
        fast = bridge.call(SAY, {"text": TEXT, "rate": 2.0}, timeout=LIMIT)
        assert fast["duration"] < 0.75 * duration
        assert bridge.call(SAY, {"text": TEXT}, timeout=LIMIT)["duration"] == pytest.approx(
            duration, rel=0.05
        )


def test_a_text_is_said_to_its_end_or_refused() -> None:
    with bridged(voice={"driver": "espeak", "play": "never"}) as (bridge, _):
        durations = [
            bridge.call(SAY, {"text": text}, timeout=LIMIT)["duration"]
            for text in ("One two three four.", "One two\0three four.")
        ]
        assert durations[1] == pytest.approx(durations[0], rel=0.1)
        with pytest.raises(MessageError, match=r"speechGeneration\.text: .*surrogates"):
            bridge.call(SAY, {"text": "half of a pair: \ud83d"})


def test_files_without_a_directory_go_with_the_bridge() -> None:
    with bridged(voice={"driver": "espeak", "play": "never"}) as (bridge, _):
        file = Path(bridge.call(SAY, {"text": "Hello."})["file"])
        assert file.is_file()
    assert not file.parent.exists()


def test_files_in_a_directory_of_their_own_stay(tmp_path: Path) -> None:
    options: dict[str, object] = {"driver": "espeak", "directory": str(tmp_path), "play": "never"}
    with bridged(voice=options) as (bridge, _):
        file = Path(bridge.call(SAY, {"text": "Hello."})["file"])
    assert file.is_file()


class Slow(Engine):
    """Makes one sound at once and the others when it is allowed to."""

    name = "slow"
    voice = "any"

    def __init__(self) -> None:
        self.begun = threading.Event()
        self.go_on = threading.Event()
        self.count = 0

    def check(self) -> None:
        """Always there."""

    def speak(self, text: str, voice: str, rate: float, timeout: float) -> Sound:
        self.count += 1
        if self.count > 1:
            self.begun.set()
            assert self.go_on.wait(LIMIT)
        return Sound(bytes(200), 8000)


FORKED = """
import os, sys
from uoarm_rocos._options import DeviceOptions
from uoarm_rocos.speech import Sound, Speech

class Engine:
    name = voice = "quick"
    def check(self):
        pass
    def speak(self, text, voice, rate, timeout):
        return Sound(bytes(200), 8000)

speech = Speech("voice", Engine(), DeviceOptions(play="never"))
(api,) = speech.catalogue(0.0).apis.values()
file = speech.call(api, {"text": "x"}, 60.0)["file"]
pid = os.fork()
if pid == 0:
    sys.exit(3)
print("child", os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), os.path.exists(file))
print(file)
"""


def test_a_child_that_is_forked_leaves_the_files_of_its_parent() -> None:
    done = run_python("-c", FORKED)
    line, file = done.stdout.splitlines()
    assert line == "child 3 True", done.stderr
    assert not Path(file).parent.exists(), "the parent removes them as it ends"


def test_a_device_that_is_closed_while_it_speaks_leaves_no_files_behind() -> None:
    engine = Slow()
    speech = Speech("voice", engine, DeviceOptions(play="never"))
    (api,) = speech.catalogue(0.0).apis.values()
    file = Path(speech.call(api, {"text": "x"}, LIMIT)["file"])
    speaking = Background(partial(speech.call, api, {"text": "x"}, LIMIT))
    assert engine.begun.wait(LIMIT)
    speech.close()
    assert file.exists(), "the call that is under way may be writing"
    engine.go_on.set()
    with pytest.raises(BridgeError) as raised:
        speaking.result()
    assert raised.value.reason is FailureReason.CLOSED
    assert not file.parent.exists()


def test_a_call_that_was_stalled_past_its_limit_is_out_of_time() -> None:
    with bridged(voice={"driver": "espeak", "play": "never"}) as (bridge, _):
        given: Any = bridge
        with pytest.raises(BridgeTimeoutError, match="longer than 0 s"):
            given._call(SAY, ServiceStructures(), {"text": "x"}, 0.0)


def test_a_voice_that_does_not_exist_is_refused() -> None:
    with bridged(voice={"driver": "espeak", "play": "never"}) as (bridge, _):
        with pytest.raises(BridgeError, match="no voice 'unknown'") as raised:
            bridge.call(SAY, {"text": "x", "voice": "unknown"})
        assert raised.value.reason is FailureReason.BAD_MESSAGE
        with pytest.raises(MessageError, match=r"text: expected at most 1000 characters"):
            bridge.call(SAY, {"text": "x" * 1001})
        assert bridge.call(SAY, {"text": "I can still speak."})["duration"] > 0.5


def test_words_of_festival_are_no_code() -> None:
    with pytest.raises(BridgeError, match="no name of a Festival voice"):
        FestivalEngine().speak("x", 'kal) (system "true"', 1.0, LIMIT)


def test_a_missing_engine_is_unavailable_with_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with bridged(voice={"driver": "festival"}) as (bridge, _):
        with pytest.raises(BridgeError, match="apt install festival") as raised:
            bridge.describe(SAY)
        assert raised.value.reason is FailureReason.UNAVAILABLE
    monkeypatch.setitem(sys.modules, "espeakng_loader", None)
    with pytest.raises(BridgeError, match=r"pip install .*uoarm-rocos\[speech\]"):
        speech_module._library.__wrapped__()


def test_priorities_choose_the_engine_that_is_there(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    file = tmp_path / "robot.yaml"
    file.write_text(
        f"""
version: 1
bridges:
  rocos:
    plugin: rocos
    options:
      devices:
        festival: {{driver: festival}}
        espeak: {{driver: espeak, play: never, directory: "{tmp_path}"}}
functions:
  speechGeneration:
    components:
      - name: paper
        bridge: rocos
        priority: 20
        service: {{endpoint: [festival, speechGeneration]}}
      - name: small
        bridge: rocos
        priority: 10
        service: {{endpoint: [espeak, speechGeneration]}}
"""
    )
    with RobotManager.from_file(file) as manager:
        assert manager.call("speechGeneration", {"text": "Kia ora."})["duration"] > 0.3


def player(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str) -> Path:
    """A stand-in for the sound card: a program in place of aplay."""
    program = tmp_path / "player"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(program.stat().st_mode | stat.S_IEXEC)
    monkeypatch.setattr(speech_module, "_player", lambda: [str(program)])
    return tmp_path / "played.wav"


def test_sound_goes_to_the_player_where_there_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played = player(tmp_path, monkeypatch, f"cat > {tmp_path}/played.wav")
    with bridged(voice={"driver": "espeak"}) as (bridge, _):
        reply = bridge.call(SAY, {"text": "Hello."})
        assert reply["played"] is True
        assert "file" not in reply
        assert played.read_bytes() == reply["audio"]


def test_a_player_that_fails_or_hangs_is_an_error_within_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    player(tmp_path, monkeypatch, "echo no card >&2; exit 3")
    with bridged(voice={"driver": "espeak"}) as (bridge, _):
        with pytest.raises(BridgeError, match="no card"):
            bridge.call(SAY, {"text": "Hello."})
        player(tmp_path, monkeypatch, "exec sleep 100000")
        with pytest.raises(BridgeTimeoutError):
            bridge.call(SAY, {"text": "Hello."}, timeout=0.5)
    speech = Speech("voice", EspeakEngine(), DeviceOptions())
    (api,) = speech.catalogue(0.0).apis.values()
    limit, text = 0.5, ""
    while "interrupted by its limit" not in text:  # a busy machine synthesises for as long, too
        assert limit < patience(), text
        with pytest.raises(BridgeTimeoutError) as raised:
            speech.call(api, {"text": "Hello."}, timeout=limit)
        limit, text = 2 * limit, str(raised.value)


def test_a_player_that_starts_while_the_device_is_closed_is_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    speech = Speech("voice", EspeakEngine(), DeviceOptions())
    (api,) = speech.catalogue(0.0).apis.values()
    player(tmp_path, monkeypatch, "exec sleep 100000")
    command = speech_module._player()

    def chosen() -> list[str] | None:
        speech.close()
        return command

    monkeypatch.setattr(speech_module, "_player", chosen)
    with pytest.raises(BridgeError, match="could not play the sound"):
        speech.call(api, {"text": "Hello."}, timeout=LIMIT)


def test_two_voices_at_once_do_not_mix() -> None:
    with bridged(
        one={"driver": "espeak", "play": "never"}, two={"driver": "espeak", "play": "never"}
    ) as (bridge, _):
        texts = {"one": "One.", "two": TEXT * 3}
        alone = {name: _say(bridge, name, text) for name, text in texts.items()}
        together: dict[str, float] = {}
        threads = [
            threading.Thread(
                target=lambda name=name: together.update({name: _say(bridge, name, texts[name])})
            )
            for name in texts
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(LIMIT)
        assert together == pytest.approx(alone, rel=0.02)


def _say(bridge: object, name: str, text: str) -> float:
    reply = bridge.call(  # type: ignore[attr-defined]  # a bridge
        endpoint(name, "speechGeneration", "service"), {"text": text}, timeout=LIMIT
    )
    return float(reply["duration"])
