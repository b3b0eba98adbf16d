"""The whole HealthBot: starts every part, shows what runs where, and ends them all.

Run `python examples/healthbot/scene.py --help`. Exit codes: 0 interrupted, or the visit of --visit
is over; 1 the robot died, or the visit failed; 2 a part could not be started.

Devices, patients and the robot's body are simulated; none of this is a medical device.
"""

from __future__ import annotations

import argparse
import errno
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(HERE.parent / "vision")]

_PORTS = (2809, 9280, 9080, 9281)


def main() -> int:
    """Run the scene and return the exit code."""
    parser = argparse.ArgumentParser(description="Start the whole HealthBot scene.")
    parser.add_argument("--robot", type=Path, default=HERE / "robot.yaml", help="another robot")
    parser.add_argument("--run", type=Path, metavar="FOLDER", help="keep logs and records there")
    parser.add_argument("--free-ports", action="store_true", help="do not use the usual ports")
    parser.add_argument(
        "--environments",
        action="store_true",
        help="run the bridges to ROS 2 and OpenRTM in environments of their own, made if need be",
    )
    parser.add_argument("--visit", action="store_true", help="run one visit in the terminal; end")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return _run(options)
    except KeyboardInterrupt:
        print("Everything is ended.")
        return 0


def _run(options: argparse.Namespace) -> int:
    try:
        from healthbot_scene.needs import missing, node  # noqa: PLC0415 - or it is reported
    except ModuleNotFoundError as error:
        print(f"{error.name} is not installed: see examples/healthbot/README.md", file=sys.stderr)
        return 2
    lacking = missing()
    for need in lacking:
        print(need, file=sys.stderr)
    if any(need.vital for need in lacking) or (options.visit and node() is None):
        return 2
    from healthbot_scene.crew import (  # noqa: PLC0415 - now they are there
        Crew,
        PartError,
        print_running,
        watch,
    )
    from healthbot_scene.parts import parts_of  # noqa: PLC0415
    from healthbot_scene.places import make_places  # noqa: PLC0415
    from healthbot_scene.separate import HOSTS, prepare_environments  # noqa: PLC0415
    from vision_demo.packages import FootageError  # noqa: PLC0415
    from vision_demo.ports import listens  # noqa: PLC0415

    from uoarm import UoarmError  # noqa: PLC0415

    ports = None if options.free_ports else _PORTS
    for port in filter(listens, ports or ()):
        text = f"port {port} is in use, perhaps by another scene"
        print(f"{text}: --free-ports takes others", file=sys.stderr)
        return 2
    cache = Path(os.environ.get("UOARM_CACHE", ROOT / ".cache")) / "vision"
    try:
        hosts = None
        if options.environments:
            prepare_environments(_say)
            hosts = {key: f"{{environment: {host.name}}}" for key, host in HOSTS.items()}
        with tempfile.TemporaryDirectory(prefix="healthbot-") as temporary:
            _say("Footage and faces ...")
            places = make_places(options.run or Path(temporary), cache, ports, _say)
            parts = parts_of(places, places.write_robot(options.robot, hosts), HERE / "browser")
            with Crew(places.run, places.environment()) as crew:
                crew.start_all(parts, print_running)
                _say(f"For a visit open {places.page_url}")
                _say(f"To see into the robot open {places.robot_url.replace('ws', 'http', 1)}")
                _say("Everything is ready; Ctrl-C ends it.")
                return _visit(places.robot_url) if options.visit else watch(crew)
    except BrokenPipeError:  # what it prints is read no more, as by `head`
        os._exit(1)
    except (FootageError, PartError, UoarmError, OSError) as error:
        print(error, file=sys.stderr)
        if getattr(error, "errno", 0) == errno.ENOSPC:  # what waits would fail once more
            os._exit(2)
        return 2


def _say(line: str) -> None:
    print(line, flush=True)


def _visit(url: str) -> int:
    """Run the terminal application once."""
    command = ["node", "--experimental-websocket", str(HERE / "terminal" / "main.mjs"), url]
    return subprocess.run(command, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
