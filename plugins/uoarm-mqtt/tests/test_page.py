"""The example runs as printed, with Mosquitto's own programs as peers."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
from pathlib import Path

import pytest
from brokers import Broker, Peer
from tests.processes import run_python  # type: ignore[import-not-found]
from uoarm_mqtt._options import MqttOptions, TopicOptions

from uoarm.bridge import options_table
from uoarm.testing import wait

ROOT = Path(__file__).parents[3]
PAGE = ROOT / "docs" / "mqtt.md"
EXAMPLE = ROOT / "examples" / "mqtt" / "README.md"


@pytest.mark.needs("mosquitto-clients")
def test_the_example_runs_as_printed(broker: Broker, tmp_path: Path) -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    _, peers, robot, commands, printed, program, *_ = (
        found[1] for found in re.finditer(r"```\w+\n(.*?)```", text, re.DOTALL)
    )
    (tmp_path / "robot.yaml").write_text(robot.replace("127.0.0.1", broker.host))
    environment = {**os.environ, "HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path)}
    for name in ("mosquitto_pub", "mosquitto_sub"):  # where they find the broker of the test
        (tmp_path / name).write_text(f"-h {broker.host}\n")
    watcher = Peer(broker)
    lamp = watcher.collect("lab/lamp")
    shell = subprocess.Popen(
        ["bash", "-c", peers], cwd=tmp_path, env=environment, start_new_session=True
    )
    try:
        said: list[str] = []

        def answered() -> bool:
            lines = map(shlex.split, commands.splitlines())
            done = [run_python("-m", *words, cwd=tmp_path) for words in lines]
            said[:] = [process.stdout + process.stderr for process in done]
            return not any(process.returncode for process in done)

        wait(answered, "the peers of the example did not come up")
        assert "".join(said) == printed
        assert run_python("-c", program, cwd=tmp_path).returncode == 0
        wait(lambda: lamp, "the lamp received nothing")
        assert lamp[0].payload == b'"on"'
    finally:
        os.killpg(shell.pid, 15)
        shell.wait()
        watcher.close()


def test_the_table_of_options_is_what_the_plugin_declares() -> None:
    for kind in (TopicOptions, MqttOptions):
        assert options_table(kind.schema()) in PAGE.read_text(encoding="utf-8")
