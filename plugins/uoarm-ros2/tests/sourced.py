"""What a shell has after `source /opt/ros/.../setup.bash`, and that of a workspace built by colcon.

The files are those of the wheels, laid out as an installation has them: no wheel's metadata, one
prefix with `lib`, `share` and `include`. A package of a workspace has a prefix of its own.
"""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from collections.abc import Iterable
from importlib.metadata import distributions
from pathlib import Path

import uoarm_ros2

import uoarm
from uoarm.testing import patience

_SITE = Path("lib") / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
_OF_ROS = ("ros-", "ros_", "rosidl", "rosgraph")


class Sourced:
    """An installation below a folder, with what a shell that sourced it hands on."""

    def __init__(self, folder: Path) -> None:
        self.prefix = folder / "opt" / "ros" / "jazzy"
        self.workspace = folder / "workspace"
        others = folder / "others"
        site, here = Path(sys.prefix) / _SITE, self.prefix / _SITE
        here.mkdir(parents=True)
        others.mkdir()
        ours = _top_level_of_ros(site)
        for path in site.iterdir():
            is_data = path.suffix in {".dist-info", ".egg-info", ".libs", ".pth"}
            if path.name in ours and not is_data and "bootstrapper" not in path.name:
                (here / path.name).symlink_to(path)
            elif path.name not in ours and path.suffix != ".pth":
                (others / path.name).symlink_to(path)
        for library in (*(Path(sys.prefix) / "lib").glob("*.so*"), *site.glob("ros_*.libs/*")):
            target = self.prefix / "lib" / library.name
            if not target.exists():
                target.symlink_to(library)
        for name in ("share", "include"):
            (self.prefix / name).symlink_to(Path(sys.prefix) / name)
        code = [
            str(Path(str(module_type.__file__)).parents[1]) for module_type in (uoarm, uoarm_ros2)
        ]
        wheels_alone = {"_ROS_WHEELS_BOOTSTRAP_COMPLETE", "VIRTUAL_ENV"}
        self.environment = {
            **{name: value for name, value in os.environ.items() if name not in wheels_alone},
            "AMENT_PREFIX_PATH": str(self.prefix),
            "LD_LIBRARY_PATH": str(self.prefix / "lib"),
            "PYTHONPATH": os.pathsep.join([str(here), str(others), *code]),
            "ROS_DISTRO": "jazzy",
        }
        self.python = str(Path(sys.executable).resolve())  # which has no wheels

    def add_workspace(self, wheels: Iterable[Path]) -> None:
        """Lay packages out as colcon installs them, and source that, too."""
        for wheel in wheels:
            prefix = self.workspace / "install" / wheel.name.split("-")[0]
            with zipfile.ZipFile(wheel) as archive:
                for name in archive.namelist():
                    target = _place(prefix, name)
                    if target is not None:
                        target.parent.mkdir(parents=True, exist_ok=True)
                        target.write_bytes(archive.read(name))
            for variable, path in (
                ("AMENT_PREFIX_PATH", prefix),
                ("LD_LIBRARY_PATH", prefix / "lib"),
                ("PYTHONPATH", prefix / _SITE),
            ):
                self.environment[variable] = f"{path}{os.pathsep}{self.environment[variable]}"

    def run(self, *words: str) -> str:
        """Return what Python prints there."""
        done = subprocess.run(
            [self.python, *words],
            env=self.environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=4 * patience(),
        )
        assert not done.returncode, done.stderr
        return done.stdout


def _top_level_of_ros(site: Path) -> set[str]:
    """Return what wheels of ROS 2 put into a folder of packages."""
    found = set()
    for distribution in distributions():
        if str(distribution.metadata["Name"]).lower().startswith(_OF_ROS):
            paths = [
                Path(str(distribution.locate_file(file))).resolve()
                for file in distribution.files or ()
            ]
            inside = [path for path in paths if path.is_relative_to(site.resolve())]
            found |= {path.relative_to(site.resolve()).parts[0] for path in inside}
    return found


def _place(prefix: Path, name: str) -> Path | None:
    """Return where a file of a wheel goes: libraries lie beside one another, as colcon has it."""
    if ".dist-info/" in name:
        return None
    if ".data/data/" in name:
        return prefix / name.partition(".data/data/")[2]
    file = Path(name)
    is_library = file.suffix == ".so" and file.name.startswith("lib")
    return prefix / "lib" / file.name if is_library else prefix / _SITE / file
