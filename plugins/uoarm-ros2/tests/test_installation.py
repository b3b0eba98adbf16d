"""Which ROS 2 is in use, and what happens where two lie side by side."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest
from peers import DOMAIN
from uoarm_ros2 import uoarm_bridge_types
from uoarm_ros2._installed import Wheel, absent_middleware, installation, wheels

from uoarm.bridge import install_command
from uoarm.config import assign
from uoarm.model import BridgeSpec, Robot

SYSTEM = Path("/opt/ros/jazzy/lib/python3.12/site-packages/rclpy")
VENV = Path("/home/robot/venv/lib/python3.12/site-packages")
KILTED = Wheel("kilted", VENV)


def test_the_doctor_says_what_is_used() -> None:
    doctor = uoarm_bridge_types()[0].doctor
    assert doctor is not None
    found = doctor()
    assert found["rmw"].startswith("rmw_")
    assert found["domain"] == str(DOMAIN)
    assert Path(found["rclpy"]).is_dir()
    assert found["distribution"] == f"{wheels()[0].distribution}, from wheels"
    assert "conflict" not in found


def test_two_distributions_in_hosts_get_domains_of_their_own() -> None:
    kind = uoarm_bridge_types()[0]
    hosts = {name: {"environment": name} for name in ("jazzy", "kilted")}
    specs = {name: BridgeSpec(name, "ros2", {}, host) for name, host in hosts.items()}
    robot = assign(Robot(specs, {}), {"ros2": kind})
    found = [spec.options["domain_id"] for spec in robot.bridges.values()]
    free = [number for number in range(64, 102) if number != DOMAIN]
    assert found == free[:2]


def test_a_sourced_installation_is_named_by_its_environment() -> None:
    found = installation(SYSTEM, {"ROS_DISTRO": "jazzy"}, [])
    assert (found.distribution, found.origin[:6], found.conflict) == ("jazzy", "a ROS ", "")


def test_wheels_beside_a_sourced_installation_are_a_conflict_once_their_libraries_are() -> None:
    quiet = {"ROS_DISTRO": "jazzy", "LD_LIBRARY_PATH": "/opt/ros/jazzy/lib"}
    assert installation(SYSTEM, quiet, [KILTED]).conflict == ""
    mixed = {**quiet, "LD_LIBRARY_PATH": f"{VENV}/ros_rcl.libs{os.pathsep}/opt/ros/jazzy/lib"}
    found = installation(SYSTEM, mixed, [KILTED])
    assert found.distribution == "jazzy"
    assert f"wheels of kilted in {VENV}" in found.conflict


def test_wheels_of_two_distributions_in_one_place_are_a_conflict() -> None:
    found = installation(VENV / "rclpy", {}, [Wheel("jazzy", VENV), KILTED])
    assert found.conflict.startswith("wheels of jazzy and kilted share")


def test_a_missing_rclpy_names_what_to_install() -> None:
    code = (
        "import sys; sys.modules['rclpy'] = None\n"
        "from uoarm_ros2 import uoarm_bridge_types\n"
        "kind = uoarm_bridge_types()[0]\n"
        "try: kind.doctor()\n"
        "except Exception as error: print(type(error).__name__, error)\n"
        "try: kind.create('ros', {})\n"
        "except Exception as error: print(type(error).__name__, error)\n"
    )
    missing, raised = output(code).splitlines()
    assert install_command("uoarm-ros2", "jazzy") in missing
    assert raised.startswith("PluginError bridge 'ros': rclpy cannot be imported")


@pytest.mark.parametrize(
    ("variable", "value", "words"),
    [
        ("ROS_DOMAIN_ID", "500", "BridgeError the environment says ROS_DOMAIN_ID='500', expected"),
        ("ROS_DOMAIN_ID", "lab", "BridgeError the environment says ROS_DOMAIN_ID='lab', expected"),
        ("RMW_IMPLEMENTATION", "rmw_none_cpp", "PluginError bridge 'ros': the environment says"),
    ],
)
def test_an_environment_that_would_end_the_process_is_an_error(
    variable: str, value: str, words: str
) -> None:
    """Fast DDS calls exit() for such a domain, ROS 2 for a middleware that is not there."""
    code = (
        "from uoarm.bridge import Registry\n"
        "from uoarm.model import BridgeSpec\n"
        "try: Registry().create(BridgeSpec('ros', 'ros2', {}))\n"
        "except Exception as error: print(type(error).__name__, error)\n"
    )
    assert output(code, **{variable: value}).startswith(words)


def test_an_absent_middleware_is_reported_with_those_present() -> None:
    code = (
        "from uoarm_ros2 import uoarm_bridge_types\n"
        "try: uoarm_bridge_types()[0].doctor()\n"
        "except Exception as error: print(type(error).__name__, error)\n"
    )
    text = output(code, RMW_IMPLEMENTATION="rmw_none_cpp")
    assert text.startswith("PluginError the environment says RMW_IMPLEMENTATION=rmw_none_cpp")
    assert "only rmw_fastrtps_cpp: unset the variable" in text
    assert output(code, RMW_IMPLEMENTATION="rmw_fastrtps_cpp") == ""


def test_without_known_libraries_no_middleware_is_missing(tmp_path: Path) -> None:
    environment = {"RMW_IMPLEMENTATION": "rmw_none_cpp", "LD_LIBRARY_PATH": f"{tmp_path}"}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "prefix", str(tmp_path))
        assert absent_middleware(environment) == ""
        (tmp_path / "librcl.so").touch()
        assert "only none" in absent_middleware(environment)
        (tmp_path / "librmw_none_cpp.so").touch()
        assert absent_middleware(environment) == ""


def test_a_package_whose_libraries_are_not_found_is_named(tmp_path: Path) -> None:
    """As where PYTHONPATH has a workspace and LD_LIBRARY_PATH lacks it."""
    package = files("std_srvs")
    shutil.copytree(str(package), tmp_path / "std_srvs", ignore=shutil.ignore_patterns("*.so"))
    code = (
        "from uoarm.bridge import Registry\n"
        "from uoarm.model import BridgeSpec, Endpoint, Role\n"
        "at = Endpoint('ros', 'lamp', Role.SERVICE, ('/lamp', 'std_srvs/srv/SetBool'))\n"
        "bridge = Registry().create(BridgeSpec('ros', 'ros2', {}))\n"
        "try: bridge.serve(at, print)\n"
        "except Exception as error: print(type(error).__name__, error)\n"
        "bridge.close()\n"
    )
    text = output(code, PYTHONPATH=f"{tmp_path}")
    wanted = "BridgeError opening an end of ROS 2: the libraries of package 'std_srvs' cannot be "
    assert text.startswith(wanted)
    assert "source the workspace" in text


def test_importing_the_plugin_imports_no_middleware() -> None:
    code = "import sys, uoarm_ros2; uoarm_ros2.uoarm_bridge_types(); print('rclpy' in sys.modules)"
    assert output(code) == "False"


def test_a_process_that_says_so_is_left_alone_by_the_wheels() -> None:
    """The advice that the conflict gives: the wheels' start-up code then changes nothing."""
    code = "import os; print(os.environ.get('LD_LIBRARY_PATH'))"
    assert output(code, _ROS_WHEELS_BOOTSTRAP_COMPLETE="1") == "None"
    assert "ros_" in output(code)


def output(code: str, **environment: str) -> str:
    """What a fresh interpreter prints, without what the wheels set in this one."""
    inherited = {"LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    kept = {name: value for name, value in os.environ.items() if name not in inherited}
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={**kept, **environment},
    )
    return done.stdout.strip()


def test_topics_have_their_full_names_and_nothing_else_is_one() -> None:
    topic = uoarm_bridge_types()[0].topic
    assert topic is not None
    assert topic(("chatter", "std_msgs/msg/String"), {}) == "/chatter"
    assert topic(("/chatter",), {}) == "/chatter"
    assert topic(("/add", "example_interfaces/srv/AddTwoInts"), {}) == ""
    assert topic(("/go", "test_msgs/action/Fibonacci", "goal"), {}) == ""
