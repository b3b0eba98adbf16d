"""What a hint says to install: from where this uoarm came, as long as that is there."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from uoarm import _origin
from uoarm.bridge import install_command


def install(site: Path, origin: object) -> None:
    """Make a uoarm on the path whose installer noted where it came from."""
    info = site / "uoarm-7.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: uoarm\nVersion: 7.0\n")
    if origin is not None:
        (info / "direct_url.json").write_text(json.dumps(origin))


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    return folder


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    folder = tmp_path / "my checkout"
    (folder / "plugins" / "uoarm-absent").mkdir(parents=True)
    (folder / "plugins" / "uoarm-absent" / "pyproject.toml").write_text("")
    return folder


@pytest.mark.parametrize(("editable", "option"), [(True, "-e "), (False, "")])
def test_a_checkout(site: Path, checkout: Path, editable: bool, option: str) -> None:
    install(site, {"url": checkout.as_uri(), "dir_info": {"editable": editable}})
    assert install_command("uoarm", "server") == f"pip install {option}'{checkout}[server]'"
    plugin = checkout / "plugins" / "uoarm-absent"
    assert install_command("uoarm-absent", "x") == f"pip install {option}'{plugin}[x]'"
    assert install_command("uoarm-nowhere") == "pip install uoarm-nowhere"


def test_an_extra_that_brings_another_distribution_of_the_same_checkout(
    site: Path, checkout: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(site, {"url": checkout.as_uri(), "dir_info": {"editable": True}})
    monkeypatch.setattr(_origin, "_BROUGHT", {("uoarm", "server"): "uoarm-absent"})
    plugin = checkout / "plugins" / "uoarm-absent"
    both = f"pip install -e '{checkout}[server]' -e '{plugin}'"
    assert install_command("uoarm", "server") == both
    assert install_command("uoarm", "hosts") == f"pip install -e '{checkout}[hosts]'"


def test_a_wheel_and_those_beside_it(site: Path, tmp_path: Path) -> None:
    wheel = tmp_path / "uoarm-7.0-py3-none-any.whl"
    wheel.touch()
    plugin = tmp_path / "uoarm_absent-2.0-py3-none-any.whl"
    plugin.touch()
    install(site, {"url": wheel.as_uri(), "archive_info": {}})
    assert install_command("uoarm", "hosts") == f"pip install '{wheel}[hosts]'"
    assert install_command("uoarm-absent") == f"pip install {plugin}"


@pytest.mark.parametrize(
    "origin",
    [None, {"url": "file:///no/such/folder", "dir_info": {}}, {"url": "https://a.example/b.whl"}],
)
def test_an_index_or_what_is_gone(site: Path, origin: object) -> None:
    install(site, origin)
    assert install_command("uoarm", "server") == "pip install 'uoarm[server]'"
    assert install_command("uoarm-absent") == "pip install uoarm-absent"
