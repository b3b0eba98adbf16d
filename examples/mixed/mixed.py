"""ROS 1, ROS 2 and MQTT in one application; the camera of ROS 1 is killed, and comes back.

It starts a master, a broker, two cameras and a sensor on loopback, ends by itself, and ends all.
"""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import argparse
import os
import queue
import secrets
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from string import Template
from typing import Any

from uoarm import RobotManager
from uoarm.config import loads
from uoarm.errors import UoarmError

HERE = Path(__file__).resolve().parent
DEBIAN = Path("/usr/bin/python3"), Path("/usr/lib/python3/dist-packages/rospy")
ROSMASTER = Path("/usr/bin/rosmaster")
BETWEEN = 100  # what is darker is of ROS 1
AIM = 1.0  # seconds that a takeover may take


class PartError(Exception):
    """A part has ended by itself; the text says which, and what it wrote last."""


class Parts:
    """The processes around the application, each of which knows nothing of uoarm.

    Attributes:
        has_rospy: whether Debian's ROS 1 is used; else what stands in for it.
    """

    def __init__(self, folder: Path, *, alone: bool) -> None:
        self.folder = folder
        self.has_rospy = not alone and all(path.exists() for path in (*DEBIAN, ROSMASTER))
        self.master, self.broker, self.domain = free_port(), free_port(), 64 + secrets.randbelow(38)
        self._processes: dict[str, subprocess.Popen[bytes]] = {}

    @property
    def uri(self) -> str:
        """Where the master is."""
        return f"http://127.0.0.1:{self.master}"

    def start(self, name: str) -> None:
        """Start a part, which the kernel ends when this process is killed."""
        command = ("setpriv", "--pdeathsig", "KILL", *self._command(name))
        with (self.folder / f"{name}.log").open("ab") as log:
            self._processes[name] = subprocess.Popen(
                command, stdout=log, stderr=log, env=self._environment()
            )

    def kill(self, name: str) -> None:
        """End a part without a word."""
        self._processes[name].kill()
        self._processes[name].wait()

    def until(self, is_so: Callable[[], bool], what: str, seconds: float) -> None:
        """Wait until something is so.

        Raises:
            PartError: a part has ended meanwhile.
            TimeoutError: it is not, so long.
        """
        deadline = time.monotonic() + seconds
        while not is_so():
            for name, process in self._processes.items():
                if process.poll() is not None:
                    said = (self.folder / f"{name}.log").read_text("utf-8", "replace").split("\n")
                    why = next(filter(None, reversed(said)), "it wrote nothing")
                    raise PartError(f"{name} ended with {process.returncode}: {why}")
            if time.monotonic() > deadline:
                raise TimeoutError(f"{what}: not within {seconds:g} s")
            time.sleep(0.02)

    def end(self) -> None:
        """End all."""
        for process in self._processes.values():
            process.kill()
        for process in self._processes.values():
            process.wait()

    def log(self) -> str:
        """Return what the parts wrote."""
        return "\n".join(
            f"{path.stem}: {path.read_text('utf-8', 'replace')[-500:]}"
            for path in sorted(self.folder.glob("*.log"))
        )

    def _command(self, name: str) -> Sequence[str]:
        python, alone = sys.executable, str(HERE / "ros1_alone.py")
        if name == "broker":
            file = self.folder / "mosquitto.conf"
            lines = f"listener {self.broker} 127.0.0.1", "allow_anonymous true", "persistence false"
            # As root it would become another user, and outlive us.
            user = ("user root",) if os.geteuid() == 0 else ()
            file.write_text("\n".join((*lines, *user)))
            return [mosquitto() or "mosquitto", "-c", str(file)]
        commands: Mapping[str, Sequence[str]] = {
            "sensor": [python, str(HERE / "sensor.py"), f"mqtt://127.0.0.1:{self.broker}"],
            "new camera": [python, str(HERE / "ros2_camera.py")],
            "master": [python, alone, "master", str(self.master)],
            "old camera": [python, alone, "camera", self.uri],
        }
        if self.has_rospy:
            debian: Mapping[str, Sequence[str]] = {
                "master": [str(ROSMASTER), "--core", "-p", str(self.master)],
                "old camera": [str(DEBIAN[0]), str(HERE / "ros1_camera.py")],
            }
            commands = {**commands, **debian}
        return commands[name]

    def _environment(self) -> dict[str, str]:
        ros = {"ROS_MASTER_URI": self.uri, "ROS_IP": "127.0.0.1", "ROS_HOME": str(self.folder)}
        local = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": str(self.domain)}
        return {**os.environ, **ros, **local}


def free_port() -> int:
    """Return a free port of loopback."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port: int = server.getsockname()[1]
        return port


def mosquitto() -> str | None:
    """Return the broker; Debian has it where only root looks for programs."""
    return shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")


@contextmanager
def running(*, alone: bool) -> Iterator[Parts]:
    """Run all parts in a folder of their own."""
    with tempfile.TemporaryDirectory(prefix="uoarm-mixed-") as folder:
        parts = Parts(Path(folder), alone=alone)
        try:
            for name in ("master", "broker", "new camera"):
                parts.start(name)
            parts.until(
                lambda: answers(parts.master) and answers(parts.broker), "master and broker", 60
            )
            for name in ("old camera", "sensor"):
                parts.start(name)
            yield parts
        except (BrokenPipeError, PartError):
            raise
        except Exception:
            print(parts.log(), file=sys.stderr)
            raise
        finally:
            parts.end()


def answers(port: int) -> bool:
    """Return whether something listens there."""
    try:
        socket.create_connection(("127.0.0.1", port), 1).close()
    except OSError:
        return False
    return True


class Reports:
    """What the application gets."""

    def __init__(self) -> None:
        self._came: queue.Queue[Any] = queue.Queue()
        self.take = self._came.put

    def wait_for(self, framework: str, seconds: float) -> float:
        """Wait for a report of a camera's picture; return how many seconds that took.

        Raises:
            TimeoutError: none came.
        """
        began = time.monotonic()
        while (left := began + seconds - time.monotonic()) > 0:
            try:
                report = self._came.get(timeout=left)
            except queue.Empty:
                break
            if ("ROS 1" if report["brightness"] < BETWEEN else "ROS 2") == framework:
                return time.monotonic() - began
        raise TimeoutError(f"no picture of {framework} within {seconds:g} s")

    def clear(self) -> None:
        """Forget what came."""
        while not self._came.empty():
            self._came.get_nowait()


def main() -> int:
    """Run it; the exit status is 1 without pictures, 2 where something is missing or has ended.

    130 when it was interrupted, by Ctrl-C or SIGTERM.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=3, help="how often the camera is killed")
    parser.add_argument("--patience", type=float, default=30, help="seconds to wait for a picture")
    parser.add_argument("--alone", action="store_true", help="do without Debian's ROS 1")
    options = parser.parse_args()
    if mosquitto() is None:
        print("mosquitto, the MQTT broker, is not here: apt install mosquitto", file=sys.stderr)
        return 2
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)
        with running(alone=options.alone) as parts:
            return show(parts, options.times, options.patience)
    except PartError as error:
        print(error, file=sys.stderr)
        return 2
    except (TimeoutError, UoarmError) as error:
        print(error, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    except OSError as failure:  # what it prints is read no more, as by `head`, or a disk is full
        if not isinstance(failure, BrokenPipeError):
            print(failure.strerror or failure, file=sys.stderr)
        os._exit(1)


def show(parts: Parts, times: int, patience: float) -> int:
    """Request the report, and kill the camera of ROS 1 again and again."""
    whose = (
        "rospy and rosmaster of Debian"
        if parts.has_rospy
        else "no rospy here: a master and a node of our own in plain Python (ros1_alone.py)"
    )
    print(f"ROS 1: {whose}", flush=True)
    words = {
        "master": parts.uri,
        "domain": parts.domain,
        "broker": f"mqtt://127.0.0.1:{parts.broker}",
        "here": HERE,
    }
    text = Template((HERE / "robot.yaml").read_text()).substitute(words)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    reports = Reports()
    with RobotManager(loads(text, origin=str(HERE / "robot.yaml"))) as robot:
        parts.until(lambda: has_all(robot), "both cameras and the sensor", patience)
        with robot.request("report") as connection:
            connection.subscribe(reports.take)
            reports.wait_for("ROS 1", patience)
            print("the application gets pictures of ROS 1, and temperatures of MQTT", flush=True)
            for _ in range(times):
                parts.kill("old camera")
                reports.clear()
                took = reports.wait_for("ROS 2", patience)
                verdict = "" if took <= AIM else f", which is more than {AIM:g} s: a busy machine?"
                print(f"kill -9: ROS 2 takes over after {took:.2f} s{verdict}", flush=True)
                parts.start("old camera")
                took = reports.wait_for("ROS 1", patience)
                print(f"it was started again: ROS 1 is back after {took:.2f} s", flush=True)
    print("all is ended", flush=True)
    return 0


def has_all(robot: RobotManager) -> bool:
    """Return whether every component is there, so that one can take over from the other."""
    functions = robot.check_availability()
    return not any(part.cause for function in functions for part in function.candidates)


if __name__ == "__main__":
    sys.exit(main())
