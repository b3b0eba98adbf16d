"""Environments: what they are made of, how they are made, and what is said of broken ones."""

from __future__ import annotations

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.processes import lives, run_program

import uoarm
from uoarm import environments
from uoarm.bridge import _registry
from uoarm.cli import main
from uoarm.environments import _environment
from uoarm.errors import PluginError
from uoarm.testing import patience, wait


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("UOARM_HOME", str(tmp_path))
    return tmp_path / "environments"


def _executable(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


def _fake_uv(folder: Path, install: str) -> str:
    """A stand-in for uv that notes what it was asked for."""
    text = f"""
echo "$@" >> {folder}/asked
if [ "$1" = venv ]; then mkdir -p "$4/bin"; ln -s "{sys.executable}" "$4/bin/python"; exit 0; fi
{install}"""
    return str(_executable(folder / "uv", text))


@pytest.mark.parametrize("command", ["list", "doctor"])
def test_that_there_is_none_is_said(home: Path, command: str) -> None:
    shown = CliRunner().invoke(main, ["env", command])
    assert (shown.exit_code, shown.stdout) == (0, "")
    assert "there are no environments: make one with uoarm env create" in shown.stderr


def test_an_environment_for_the_python_bridge_needs_this_same_uoarm_only() -> None:
    (only,) = environments.requirements("python", None)
    assert only.startswith(("uoarm[hosts] @ file://", f"uoarm[hosts]=={uoarm.__version__}"))


def test_a_plugin_that_is_not_installed_here_is_taken_from_the_index_with_its_extra(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(_registry._KNOWN, "absent", ("uoarm-absent", ""))
    assert environments.requirements("absent", "jazzy")[1:] == ("uoarm-absent[jazzy]",)


@pytest.mark.parametrize(
    ("plugin", "hint"),
    [("mqqt", "did you mean 'mqtt'?"), ("gripper", "of others it is added by --with uoarm-grip")],
)
def test_what_nothing_knows_is_not_asked_of_an_index(
    home: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, plugin: str, hint: str
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    _fake_uv(tmp_path, "")
    made = CliRunner().invoke(main, ["env", "create", "x", "--plugin", plugin])
    assert made.exit_code == 4
    assert f"there is no plugin '{plugin}' (known: mqtt, python, " in made.stderr
    assert hint in made.stderr
    assert not (tmp_path / "asked").exists()
    assert not home.exists()


@pytest.mark.parametrize("plugin", ["recording", "status"])
def test_what_the_core_brings_needs_no_package_more(plugin: str) -> None:
    assert environments.requirements(plugin, None) == environments.requirements("python", None)


def test_a_project_given_by_its_path_stands_for_the_plugin() -> None:
    wanted = environments.requirements("absent", "jazzy", ("plugins/uoarm-absent[jazzy]", "more"))
    assert wanted[1:] == ("plugins/uoarm-absent[jazzy]", "more")


@pytest.mark.parametrize("more", ["plugins/uoarm-absent", "./uoarm-absent[dev,jazzyx]"])
def test_a_version_that_nothing_would_install_is_refused(more: str) -> None:
    with pytest.raises(PluginError, match=r"does not ask for 'jazzy': expected \[jazzy\] after"):
        environments.requirements("absent", "jazzy", (more,))
    assert environments.requirements("absent", None, (more,))[1:] == (more,)
    both = "./uoarm-absent[dev, jazzy]"
    assert environments.requirements("absent", "jazzy", (both,))[1:] == (both,)
    with pytest.raises(PluginError, match="the plugin python has no middleware"):
        environments.requirements("python", "jazzy")


@pytest.mark.parametrize("plugin", ["plugins/uoarm-mqtt", "uoarm-mqtt", "mqtt>=1", ""])
def test_a_package_is_no_name_of_a_plugin(plugin: str) -> None:
    with pytest.raises(PluginError, match=r"is no name of a plugin.*--with"):
        environments.requirements(plugin, None)


@pytest.mark.parametrize(
    ("more", "stands"),
    [
        ("uoarm-absent", True),
        ("uoarm_absent==1.2", True),
        ("./dist/uoarm_absent-1.2-py3-none-any.whl", True),
        ("git+https://host/uoarm-absent.git", True),
        ("uoarm-absent2", False),
        ("plugins/uoarm-absent-tools", False),
    ],
)
def test_a_longer_name_does_not_stand_for_the_plugin(more: str, stands: bool) -> None:
    if not stands:
        with pytest.raises(PluginError, match="there is no plugin 'absent'"):
            environments.requirements("absent", None, (more,))
        return
    assert environments.requirements("absent", None, (more,))[1:] == (more,)


def test_uv_makes_it_and_every_line_is_shown(tmp_path: Path, home: Path) -> None:
    reports: list[str] = []
    uv = _fake_uv(tmp_path, "echo installing")
    python = environments.create(
        "jazzy", ("a", "b[c]"), python="3.12", progress=reports.append, uv=uv
    )
    assert python == home / "jazzy" / "bin" / "python"
    assert (tmp_path / "asked").read_text().splitlines() == [
        f"venv --python 3.12 {home / 'jazzy'}",
        f"pip install --python {python} a b[c]",
    ]
    assert "installing" in reports
    (made,) = environments.listed()
    assert (made.name, made.requirements, made.is_whole) == ("jazzy", ("a", "b[c]"), True)


def test_one_that_fails_is_removed_and_its_last_lines_are_reported(
    tmp_path: Path, home: Path
) -> None:
    uv = _fake_uv(tmp_path, "echo no such project >&2; exit 2")
    with pytest.raises(PluginError, match=r"ended with status 2:\nno such project"):
        environments.create("jazzy", ("a",), uv=uv)
    assert not (home / "jazzy").exists()


def test_what_a_step_has_started_ends_with_it(tmp_path: Path, home: Path) -> None:
    uv = _fake_uv(tmp_path, "sleep 1000 & echo started $!; wait")
    started: list[int] = []

    def interrupt(line: str) -> None:
        if line.startswith("started"):
            started.append(int(line.split()[1]))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        environments.create("jazzy", ("a",), progress=interrupt, uv=uv)
    wait(lambda: not lives(started[0]), "it goes on")
    assert not (home / "jazzy").exists()


def test_last_lines_that_were_shown_are_not_shown_again(tmp_path: Path, home: Path) -> None:
    uv = _fake_uv(tmp_path, "echo no such project >&2; exit 2")
    reports: list[str] = []
    with pytest.raises(PluginError, match=r" a ended with status 2$"):
        environments.create("jazzy", ("a",), progress=reports.append, uv=uv)
    assert reports[-1] == "no such project"


def test_a_name_is_not_used_twice(tmp_path: Path) -> None:
    uv = _fake_uv(tmp_path, "")
    environments.create("jazzy", ("a",), uv=uv)
    with pytest.raises(PluginError, match="uoarm env remove jazzy"):
        environments.create("jazzy", ("a",), uv=uv)


@pytest.mark.parametrize("name", ["", "..", "a/b", "-x", "a b", "x" * 65])
def test_a_name_cannot_lead_elsewhere(name: str) -> None:
    with pytest.raises(PluginError, match="cannot be the name"):
        environments.create(name, ("a",))
    with pytest.raises(PluginError, match="cannot be the name"):
        environments.remove(name)


@pytest.mark.parametrize("text", ["[" * 100_000, "{", "[]", '{"requirements": 5}', ""])
def test_a_mark_that_cannot_be_read_is_an_environment_that_was_cut_short(
    tmp_path: Path, home: Path, text: str
) -> None:
    environments.create("jazzy", ("a",), uv=_fake_uv(tmp_path, ""))
    (mark,) = (path for path in (home / "jazzy").iterdir() if path.is_file())
    mark.write_text(text)
    assert [environment.is_whole for environment in environments.listed()] == [False]


@pytest.mark.parametrize("printed", ["", "hello", "[" * 5000, "[1]", '{"python": "3"}', r"\377"])
def test_an_interpreter_that_prints_something_else_is_a_finding(
    tmp_path: Path, home: Path, printed: str
) -> None:
    python = environments.create("jazzy", (), uv=_fake_uv(tmp_path, ""))
    python.parent.mkdir(parents=True, exist_ok=True)
    python.unlink(missing_ok=True)
    python.write_text(f"#!/bin/sh\nprintf '%b' '{printed}'\n")
    python.chmod(0o755)
    (made,) = environments.listed()
    assert "prints what it was not asked" in environments.examine(made).problem


def _plugin_wheel(folder: Path, plugin: str) -> Path:
    """Write the wheel of a bridge plugin, with a module, data and a command."""
    name = f"uoarm_{plugin}"
    info = f"{name}-1.0.dist-info"
    tag = "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    files = {
        f"{name}/__init__.py": f"def main() -> None: print('{plugin}')\n",
        f"{name}/data.txt": "data\n",
        f"{info}/METADATA": f"Metadata-Version: 2.1\nName: uoarm-{plugin}\nVersion: 1.0\n",
        f"{info}/WHEEL": tag,
        f"{info}/entry_points.txt": (
            f"[uoarm.bridges]\n{plugin} = {name}\n[console_scripts]\n{plugin} = {name}:main\n"
        ),
    }
    wheel = folder / f"{name}-1.0-py3-none-any.whl"
    with zipfile.ZipFile(wheel, "w") as made:
        for path, text in files.items():
            made.writestr(path, text)
        made.writestr(
            f"{info}/RECORD", "".join(f"{path},,\n" for path in (*files, f"{info}/RECORD"))
        )
    return wheel


def test_what_runs_here_is_handed_on_although_its_wheel_is_gone_and_no_index_has_it(
    tmp_path: Path, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without uv, by venv and pip, beside a wheel that is there."""
    wheel, other = _plugin_wheel(tmp_path, "little"), str(_plugin_wheel(tmp_path, "other"))
    site = tmp_path / "site"
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--target"]
    subprocess.run([*command, str(site), str(wheel)], check=True, timeout=patience())
    wheel.unlink()
    monkeypatch.syspath_prepend(site)
    (site / "uoarm_little" / "data.txt").write_text("changed here\n")
    wanted = environments.requirements("little", None)[1:]
    assert wanted == ("uoarm-little==1.0",)
    python = environments.create("lab", ("--no-index", other, *wanted), uv="")
    assert environments.listed()[0].requirements == ("--no-index", other, "uoarm-little==1.0")
    assert python.exists()
    data = {path.parent.name: path.read_text() for path in (home / "lab").rglob("data.txt")}
    assert data == {"uoarm_little": "changed here\n", "uoarm_other": "data\n"}
    report = run_program(home / "lab/bin/little", check=True)
    assert report.stdout == "little\n"


def test_what_is_pinned_to_another_version_comes_from_an_index(tmp_path: Path) -> None:
    uv = _fake_uv(tmp_path, "")
    environments.create("other", ("uoarm[hosts]==99.0", "attrs==1.0", "b"), uv=uv)
    assert (
        (tmp_path / "asked").read_text().splitlines()[1].endswith("uoarm[hosts]==99.0 attrs==1.0 b")
    )


def test_what_was_made_can_be_removed_and_nothing_else(tmp_path: Path, home: Path) -> None:
    environments.create("one", ("a",), uv=_fake_uv(tmp_path, ""))
    with pytest.raises(PluginError, match=r"no environment 'two' \(there are: one\)"):
        environments.remove("two")
    environments.remove("one")
    assert environments.listed() == []
    assert not (home / "one").exists()


def test_the_doctor_reports_what_is_missing(tmp_path: Path, home: Path) -> None:
    environments.create("good", ("a",), uv=_fake_uv(tmp_path, ""))
    good = home / "good" / "bin" / "python"
    good.unlink()
    _executable(good, f'exec "{sys.executable}" "$@"')
    _executable(home / "bad" / "bin" / "python", "echo no module named msgpack >&2; exit 1")
    (home / "bad" / "uoarm-environment.json").write_text(json.dumps({"requirements": []}))
    (home / "cut" / "bin").mkdir(parents=True)
    found = {
        environment.name: environments.examine(environment) for environment in environments.listed()
    }
    assert found["good"].problem == ""
    assert found["good"].facts["uoarm"] == uoarm.__version__
    assert "python" in found["good"].facts["plugins"]
    assert found["bad"].problem == "it lacks what a host needs: no module named msgpack"
    assert "cut short" in found["cut"].problem


def test_a_version_that_an_installed_plugin_has_not_is_refused_before_anything_is_made(
    tmp_path: Path, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    info = tmp_path / "uoarm_wheels-1.dist-info"
    info.mkdir()
    extras = "Provides-Extra: jazzy\nProvides-Extra: dev\n"
    (info / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: uoarm-wheels\nVersion: 1\n{extras}"
    )
    (info / "entry_points.txt").write_text("[uoarm.bridges]\nwheels = uoarm_wheels\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert environments.requirements("wheels", "jazzy")[1] == "uoarm-wheels[jazzy]==1"
    made = CliRunner().invoke(
        main, ["env", "create", "x", "--plugin", "wheels", "--distribution", "jazy"]
    )
    assert made.exit_code == 4
    assert "uoarm-wheels has no distribution 'jazy': there are jazzy" in made.stderr
    assert not home.exists()


def test_a_version_that_only_the_environment_shows_not_to_be_there_is_refused_as_well(
    tmp_path: Path, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The plugin is not installed here; pip and uv would only warn."""
    asked = tmp_path / "interpreter"
    extras = json.dumps({"uoarm-absent": ["jazzy", "Humble_Hawksbill", "dev"]})
    _executable(asked, f"[ $4 = uoarm ] && [ $5 = uoarm-absent ] && echo '{extras}'")
    text = f"""
if [ "$1" = venv ]; then mkdir -p "$4/bin"; cp {asked} "$4/bin/python"; fi"""
    monkeypatch.setenv("PATH", str(_executable(tmp_path / "uv", text).parent), prepend=":")
    monkeypatch.setitem(_registry._KNOWN, "absent", ("uoarm-absent", ""))
    make = ("env", "create", "x", "--plugin", "absent", "--distribution")
    made = CliRunner().invoke(main, [*make, "jazy"])
    assert made.exit_code == 4, made.output
    message = "uoarm-absent has no distribution 'jazy': there are jazzy, Humble_Hawksbill"
    assert message in made.stderr
    assert not (home / "x").exists()
    assert CliRunner().invoke(main, [*make, "humble-hawksbill"]).exit_code == 0


def test_extras_are_those_that_an_interpreter_reports(tmp_path: Path) -> None:
    found = _environment.extras_in(Path(sys.executable), ("uoarm", "absent-of-all"))
    assert "hosts" in found.pop("uoarm")
    assert found == {}
    for said in ("", "[", "[1]"):
        assert (
            _environment.extras_in(_executable(tmp_path / "p", f"echo '{said}'"), ("uoarm",)) == {}
        )


def test_a_plugin_that_lacks_its_middleware_in_an_environment_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    message = json.dumps({"uoarm": {"version": "1"}, "python": {"usable": "no: it has no camera"}})
    script = tmp_path / "interpreter"
    _executable(
        script,
        f"""
if [ "$1" = -m ] && [ "$2" = uoarm ]; then echo '{message}'
else exec "{sys.executable}" "$@"; fi""",
    )
    text = f"""
if [ "$1" = venv ]; then mkdir -p "$4/bin"; cp {script} "$4/bin/python"; fi"""
    monkeypatch.setenv("PATH", str(_executable(tmp_path / "uv", text).parent), prepend=":")
    run = CliRunner().invoke
    made = run(main, ["env", "create", "mine", "--plugin", "python"])
    assert made.exit_code == 0, made.output
    assert "warning: the plugin python cannot be used in it yet" in made.stderr
    assert made.stderr.endswith(": it has no camera\n")
    examined = run(main, ["env", "doctor"])
    assert examined.exit_code == 0
    assert examined.stderr == (
        "warning: mine: the plugin python cannot be used in it: it has no camera\n"
    )


def test_an_environment_is_examined_without_the_libraries_of_our_own_middleware(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As hosts are started: what wheels of ROS put into the environment of this process is ours."""
    monkeypatch.setenv("UOARM_HOME", str(tmp_path))
    monkeypatch.setenv("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "1")
    monkeypatch.setenv("LD_LIBRARY_PATH", f"{sys.prefix}/lib/ros:/opt/mine")
    monkeypatch.setenv("PYTHONPATH", "/ours")
    folder = tmp_path / "environments" / "kd"
    traces = tmp_path / "traces"
    message = json.dumps({"uoarm": {"version": "1"}})
    text = f"""
echo "$1 ${{LD_LIBRARY_PATH}} ${{_ROS_WHEELS_BOOTSTRAP_COMPLETE}} ${{PYTHONPATH}}." >> {traces}
if [ "$1" = -m ]; then echo '{message}'; else exec "{sys.executable}" "$@"; fi"""
    _executable(folder / "bin" / "python", text)
    (folder / "uoarm-environment.json").write_text('{"requirements": []}')
    [found] = map(environments.examine, environments.listed())
    assert found.problem == ""
    assert traces.read_text() == "-I /opt/mine  .\n-m /opt/mine  .\n"
    _environment.extras_in(folder / "bin" / "python", ("uoarm",))
    assert traces.read_text().endswith("\n-I /opt/mine  .\n")


@pytest.mark.needs("ros2")
def test_a_distribution_that_there_is_not_is_answered_with_those_that_there_are() -> None:
    with pytest.raises(
        PluginError, match=r"has no distribution 'humble': there are jazzy, kilted$"
    ):
        environments.requirements("ros2", "humble")


def test_the_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    _fake_uv(tmp_path, "")
    run = CliRunner().invoke
    made = run(main, ["env", "create", "mine", "--plugin", "python", "--with", "more"])
    assert made.exit_code == 0, made.output
    assert "environment mine is ready" in made.output
    assert json.loads(run(main, ["env", "list", "--json"]).stdout)[0]["requirements"][1] == "more"
    assert "mine: " in run(main, ["env", "list"]).output
    assert run(main, ["env", "remove", "mine"]).exit_code == 0
    assert run(main, ["env", "remove", "mine"]).exit_code == 4
    assert run(main, ["env", "doctor"]).exit_code == 0
