"""What `uoarm doctor` says of the plugin, as it is installed."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from uoarm_rosbridge._check import uoarm_checks

from uoarm.errors import PluginError
from uoarm.testing import patience


def test_doctor_names_the_endpoint() -> None:
    command = [sys.executable, "-m", "uoarm", "doctor", "--json"]
    done = subprocess.run(command, capture_output=True, check=True, timeout=patience())
    found = json.loads(done.stdout)["rosbridge server"]
    assert found == {"usable": "yes", "endpoint": "/rosbridge of uoarm serve"}


def test_without_the_packages_of_the_server_it_says_what_installs_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "uoarm_rosbridge._front_end", None)
    [check] = uoarm_checks()
    with pytest.raises(PluginError, match=r"pip install .*server"):
        check.run()
