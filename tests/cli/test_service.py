"""`uoarm doctor --service`: each thing that would not hold is found, with what to do."""

from __future__ import annotations

import errno
import json
import os
import pwd
import socket
import stat
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from uoarm.cli import main
from uoarm.cli._service import Finding, Level, examine, find_unit, read_unit
from uoarm.errors import UsageError

ROOT = Path(__file__).parents[2]
OTHER_USER = next(entry for entry in pwd.getpwall() if entry.pw_uid not in {0, os.getuid()})
BRIDGE = 4
LONG = "long" * 100
ROBOT = """
version: 1
bridges: {broker: {plugin: mqtt, options: {password_file: broker.password}}, python: {}}
functions: {}
"""


class Machine:
    """A unit with its files, as if root owned all of them, by any user who runs the test."""

    def __init__(self, folder: Path) -> None:
        self._rights: dict[Path, int] = {}
        self.folder = folder
        self.configuration = self.file("robot.yaml", ROBOT, 0o644)
        self.secret = self.file("broker.password", "x", 0o640)
        text = (ROOT / "deploy/uoarm.service").read_text(encoding="utf-8")
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            text = text.replace("9080", str(free.getsockname()[1]))
        text = text.replace("/opt/uoarm/bin/uoarm", f'"{sys.executable}" -m uoarm')
        text = text.replace("/etc/uoarm/robot.yaml", str(self.configuration))
        text = text.replace("SupplementaryGroups=dialout", "SupplementaryGroups=0")
        text = text.replace("User=uoarm", f"User={OTHER_USER.pw_name}")
        self.text = text.replace("Group=uoarm", f"Group={OTHER_USER.pw_gid}")

    def file(self, name: str, text: str, rights: int) -> Path:
        path = self.folder / name
        path.write_text(text, encoding="utf-8")
        self._rights[path] = rights
        return path

    def allow(self, path: Path, rights: int) -> None:
        self._rights[path] = rights

    def found(self, *changes: tuple[str, str]) -> dict[str, list[Finding]]:
        """Return the findings by check, of the unit with some words in the place of others."""
        text = self.text
        for before, after in changes:
            assert before in text, before
            text = text.replace(before, after)
        unit = self.folder / "uoarm.service"
        unit.write_text(text, encoding="utf-8")
        by_check: dict[str, list[Finding]] = {}
        for finding in examine(read_unit(unit), self.look):
            by_check.setdefault(finding.check, []).append(finding)
        return by_check

    def look(self, path: Path) -> os.stat_result:
        kind = stat.S_IFMT(path.stat().st_mode)
        rights = self._rights.get(path, 0o755)
        return os.stat_result((kind | rights, 0, 0, 1, 0, 0, 0, 0, 0, 0))


@pytest.fixture
def machine(tmp_path: Path) -> Machine:
    return Machine(tmp_path)


def test_the_unit_of_this_repository_has_nothing_wrong(machine: Machine) -> None:
    found = machine.found()
    assert [name for name, findings in found.items() if len(findings) != 1] == []
    assert {finding.level for findings in found.values() for finding in findings} == {Level.OK}
    assert found["secrets"][0].text == "1 files"
    assert found["memory"][0].text == "MemoryHigh 1536M, MemoryMax 2G"


@pytest.mark.parametrize(
    ("change", "check", "level", "text"),
    [
        ((f"User={OTHER_USER.pw_name}\n", ""), "user", Level.ERROR, "runs as root"),
        ((f"User={OTHER_USER.pw_name}", "User=root"), "user", Level.ERROR, "is root"),
        (
            (f"User={OTHER_USER.pw_name}", "User=not-there"),
            "user",
            Level.ERROR,
            "no user 'not-there'",
        ),
        (("Type=notify", "Type=simple"), "readiness", Level.ERROR, "before it listens"),
        (("WatchdogSec=10", ""), "readiness", Level.WARNING, "WatchdogSec is missing"),
        (("WatchdogSec=10", "WatchdogSec=500ms"), "readiness", Level.WARNING, "kills a server"),
        (("Restart=on-failure", "Restart=no"), "readiness", Level.WARNING, "stays down"),
        (("TimeoutStopSec=30", "TimeoutStopSec=2s"), "stopping", Level.WARNING, "take 30"),
        (("KillMode=mixed", ""), "stopping", Level.WARNING, "take mixed"),
        (("-HUP", "-USR1"), "stopping", Level.WARNING, "reload"),
        (("MemoryMax=2G", "MemoryMax=\nMemoryHigh="), "memory", Level.WARNING, "is missing"),
        (("MemoryMax=2G", "MemoryMax=64M"), "memory", Level.WARNING, "is little"),
        (("XDG_STATE_HOME=/var/lib/uoarm", ""), "state", Level.WARNING, "is not set"),
        (("XDG_STATE_HOME=/var/lib/uoarm", "XDG_STATE_HOME=/srv"), "state", Level.ERROR, "/srv"),
        (("--log-format json", "--audit /srv/audit"), "state", Level.ERROR, "ReadWritePaths"),
        (("NoNewPrivileges=yes", ""), "confinement", Level.WARNING, "may gain rights"),
        (("ProtectSystem=strict", ""), "confinement", Level.WARNING, "system's files"),
        (("--host 127.0.0.1", "--host 0.0.0.0"), "ports", Level.ERROR, "without --access"),
        (("--port ", "--front-end-port x=80 --port "), "ports", Level.ERROR, "80 is root's"),
        (("--log-format json", "--no-such-option"), "start", Level.ERROR, "--no-such-option"),
        (("--log-format json", '--origin "x'), "start", Level.ERROR, "No closing quotation"),
        (("Environment=", 'Environment="A=x\nEnvironment='), "state", Level.ERROR, "No closing"),
        (("--port ", "--front-end-port x=a --port "), "ports", Level.ERROR, "x=a: expected a port"),
        (("--port ", "--rosbridge-port 70000 --port "), "ports", Level.ERROR, "70000: expected"),
        (("robot.yaml --host", "gone.yaml --host"), "configuration", Level.ERROR, "gone.yaml"),
        (("robot.yaml --host", f"{LONG} --host"), "configuration", Level.ERROR, "there is no"),
        (("--log-format json", f"--access {LONG}"), "secrets", Level.ERROR, "there is no file"),
    ],
)
def test_what_does_not_hold_is_found(
    machine: Machine, change: tuple[str, str], check: str, level: Level, text: str
) -> None:
    found = machine.found(change)
    assert any(item.level is level and text in item.text for item in found[check]), found[check]


def test_rights_of_the_configuration_are_looked_at(machine: Machine) -> None:
    machine.allow(machine.configuration, 0o600)
    assert "cannot read" in machine.found()["configuration"][0].text
    machine.allow(machine.configuration, 0o666)
    first, second = machine.found()["configuration"]
    assert (first.level, second.level) == (Level.ERROR, Level.WARNING)
    assert "everyone may write" in first.text
    machine.allow(machine.configuration, 0o644)
    machine.allow(machine.folder, 0o700)
    assert "cannot enter" in machine.found()["configuration"][0].text


@pytest.mark.parametrize(("rights", "text"), [(0o644, "everyone may read"), (0o600, "cannot read")])
def test_rights_of_secrets_are_looked_at(machine: Machine, rights: int, text: str) -> None:
    machine.allow(machine.secret, rights)
    [finding] = machine.found()["secrets"]
    assert finding.level is Level.ERROR
    assert text in finding.text
    key = machine.file("key.pem", "x", rights)
    found = machine.found(("--log-format json", f"--certificate c.pem --key {key}"))["secrets"]
    assert [str(key) in item.text for item in found] == [True, False]


@pytest.mark.parametrize("words", ["-f {}", "--file={}"])
def test_a_configuration_that_is_named_by_its_option_is_looked_at(
    machine: Machine, words: str
) -> None:
    file = str(machine.configuration)
    found = machine.found((file, words.format(file)))
    assert [item.text for item in found["configuration"]] == [file]


def test_a_secret_that_is_no_name_of_a_file_is_not_repeated(machine: Machine) -> None:
    secret = f"{{password: {LONG}}}"
    machine.file("robot.yaml", ROBOT.replace("{password_file: broker.password}", secret), 0o644)
    assert [item.text for item in machine.found()["secrets"]] == ["no files of secrets are named"]


def test_what_who_asks_may_not_look_at_is_found_and_the_rest_is_looked_at(
    machine: Machine, monkeypatch: pytest.MonkeyPatch
) -> None:
    look = machine.look

    def refuse(path: Path) -> os.stat_result:
        if path == machine.configuration:
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return look(path)

    monkeypatch.setattr(machine, "look", refuse)
    found = machine.found()
    (finding,) = found["configuration"]
    assert finding.level is Level.WARNING
    assert (
        finding.text
        == f"{machine.configuration} cannot be looked at: Permission denied; ask as root"
    )
    assert found["ports"][0].level is Level.OK


def test_a_drop_in_that_is_no_file_is_not_waited_for(machine: Machine) -> None:
    folder = machine.folder / "uoarm.service.d"
    folder.mkdir()
    os.mkfifo(folder / "10-more.conf")
    with pytest.raises(UsageError, match=r"10-more\.conf: .* it is not a regular file"):
        machine.found()


def test_a_port_that_another_has_is_found(machine: Machine) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        [finding] = machine.found(("--log-format json", f"--rosbridge-port {port}"))["ports"]
    assert f"port {port}" in finding.text
    assert finding.level is Level.ERROR


def test_what_drop_ins_add_and_forget_holds(machine: Machine) -> None:
    drop_in = machine.folder / "uoarm.service.d" / "robot.conf"
    drop_in.parent.mkdir()
    drop_in.write_text("[Service]\n# more\nWatchdogSec=\\\n  30\nNoNewPrivileges=no\n", "utf-8")
    found = machine.found()
    assert found["readiness"][0].text == "watchdog 30, restart on-failure"
    assert found["confinement"][0].level is Level.WARNING


def test_units_are_found_by_name_and_by_path(tmp_path: Path) -> None:
    folder = tmp_path / "etc/systemd/system"
    folder.mkdir(parents=True)
    unit = folder / "robot.service"
    unit.write_text("[Service]\n", "utf-8")
    assert find_unit("robot", tmp_path) == find_unit("robot.service", tmp_path) == unit
    assert find_unit(str(unit)) == unit
    for name in ("other", str(tmp_path / "other.service")):
        with pytest.raises(UsageError, match="no unit"):
            find_unit(name, tmp_path)


def test_the_command_says_it_as_text_and_as_json(tmp_path: Path) -> None:
    unit = tmp_path / "uoarm.service"
    unit.write_text("[Service]\nExecStart=/no/such/uoarm serve /no/robot.yaml\n", "utf-8")

    def run(*words: str) -> Result:
        return CliRunner().invoke(main, ["doctor", "--service", *words])

    shown = run("--unit", str(unit))
    assert shown.exit_code == BRIDGE
    assert "no program that can be run" in shown.stdout
    report = run("--unit", str(unit), "--json")
    assert report.exit_code == BRIDGE
    found = json.loads(report.stdout)
    assert (found["unit"], found["usable"]) == (str(unit), False)
    assert {"check": "user", "level": "error"}.items() <= {
        key: value for key, value in found["findings"][1].items() if key != "text"
    }.items()
    missing = run("--unit", str(tmp_path / "none.service"))
    assert missing.exit_code == 1
    assert "there is no unit file" in missing.stderr


@pytest.mark.needs("systemd")
def test_what_systemd_says_of_the_unit_is_among_it(machine: Machine) -> None:
    [finding] = machine.found(("WatchdogSec=10", "WatchdogSec=soon"))["systemd"]
    assert "soon" in finding.text or "WatchdogSec" in finding.text
