"""Jazzy publishes, Kilted receives: two versions of ROS 2 side by side, from one command.

Makes both environments when they are missing; that takes a minute or two and some 600 MB.
"""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from uoarm import ResolutionError, RobotManager, UoarmError, environments

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
DOMAINS = {"jazzy": "61", "kilted": "62"}
MESSAGES = 5
PATIENCE_SECONDS = 60.0


def main() -> int:
    """Make what is missing, play, and return 0 when Kilted received everything."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    for version in DOMAINS:
        if version not in {environment.name for environment in environments.listed()}:
            plugin = f"{ROOT / 'plugins' / 'uoarm-ros2'}[{version}]"
            wanted = environments.requirements("ros2", version, (plugin,))
            environments.create(version, wanted, progress=print)
    with ExitStack() as stack:
        stack.enter_context(_node("jazzy", ROOT / "examples" / "ros2" / "talker.py"))
        robot = stack.enter_context(RobotManager.from_file(HERE / "robot.yaml"))
        _open(robot)
        listener = stack.enter_context(_node("kilted", HERE / "listener.py", str(MESSAGES)))
        listener.wait(PATIENCE_SECONDS)
        for route in robot.status().routes:
            print(f"{route.producer} -> {route.consumer}: {route.delivered} delivered")
    return listener.returncode


def _open(robot: RobotManager) -> None:
    """Open the relay as soon as the talker is seen."""
    deadline = time.monotonic() + PATIENCE_SECONDS
    while True:
        try:
            robot.request("repeat")
        except ResolutionError:
            if time.monotonic() > deadline:
                raise
            time.sleep(0.5)
        else:
            return


@contextmanager
def _node(version: str, *command: Path | str) -> Iterator[subprocess.Popen[bytes]]:
    """Run a node of one version in its own environment and domain, ended with the block."""
    variables = dict(os.environ)
    for trace in ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "PYTHONPATH"):
        variables.pop(trace, None)
    variables["ROS_DOMAIN_ID"] = DOMAINS[version]
    python = str(environments.environment_python(version))
    with_us = ("setpriv", "--pdeathsig", "TERM")  # the kernel ends it when this process is killed
    process = subprocess.Popen([*with_us, python, *map(str, command)], env=variables)
    try:
        yield process
    finally:
        process.terminate()
        try:
            process.wait(5)
        except subprocess.TimeoutExpired:
            process.kill()


if __name__ == "__main__":
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)
        sys.exit(main())
    except KeyboardInterrupt:
        sys.exit(130)
    except UoarmError as failure:
        sys.exit(str(failure))
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)
