"""`uoarm doctor --service`: what of an installed systemd unit would not hold."""

from __future__ import annotations

import errno
import grp
import os
import pwd
import re
import shlex
import shutil
import socket
import stat
import subprocess
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from enum import Enum
from pathlib import Path
from typing import Any

import click
from attrs import frozen

from uoarm._raised import reason_of
from uoarm._support.files import UnreadableFileError, read_text
from uoarm.errors import UoarmError, UsageError

_UNREADABLE = "UOA-101"
_FOLDERS = ("etc", "run", "usr/local/lib", "usr/lib", "lib")
_SETTING = re.compile(r"\s*([A-Za-z]+)\s*=\s*(.*)")
_SPAN = re.compile(r"(\d+(?:\.\d+)?)\s*(us|ms|s|sec|min|m|h|hr|d|)\b")
_UNITS = {"us": 1e-6, "ms": 1e-3, "": 1.0, "s": 1.0, "sec": 1.0}
_UNITS |= {"min": 60.0, "m": 60.0, "h": 3600.0, "hr": 3600.0, "d": 86400.0}
_SIZE = re.compile(r"(\d+)([KMGT]?)")
_LEAST_WATCHDOG, _LEAST_STOP = 2.0, 10.0
_LEAST_MEMORY = 256 * 2**20
_LEAST_FREE_PORT, _LAST_PORT = 1024, 65_535
_MOST_OCTETS = 1_000_000
_SECRET = re.compile(r"password|secret|token|(^|_)key(_|$)|credential")
_LOOPBACK = {"127.0.0.1", "::1", "localhost"}
_SYSTEMD_SECONDS = 60.0
_GROUP, _ALL = 0o020, 0o002


class Level(Enum):
    """How a finding is meant."""

    OK = "ok"
    WARNING = "warning"
    ERROR = "error"


@frozen
class Finding:
    """What one look has found.

    Attributes:
        check: what was looked at.
        level: whether it holds.
        text: what was found, and what to do where it does not hold.
    """

    check: str
    level: Level
    text: str


@frozen
class ServiceUser:
    """As whom a service runs."""

    name: str
    uid: int
    groups: frozenset[int]


@frozen
class Unit:
    """A unit file with its drop-ins.

    Attributes:
        settings: every assignment in order, as section, key and value.
    """

    path: Path
    settings: tuple[tuple[str, str, str], ...]

    def values(self, key: str, section: str = "Service") -> tuple[str, ...]:
        """Return what is assigned to a key; an empty assignment forgets those before it."""
        found: list[str] = []
        for place, name, value in self.settings:
            if (place, name) == (section, key):
                found = [*found, value] if value else []
        return tuple(found)

    def value(self, key: str, default: str = "", section: str = "Service") -> str:
        """Return what is assigned to a key last."""
        return (self.values(key, section) or (default,))[-1]

    def is_on(self, key: str) -> bool:
        return self.value(key).lower() in {"yes", "true", "on", "1"}


def find_unit(name: str, root: Path = Path("/")) -> Path:
    """Return the file of a unit, by path or by name.

    Raises:
        UsageError: there is none.
    """
    if "/" in name:
        if os.path.isfile(name):
            return Path(name)
        raise UsageError(f"there is no unit file {name}", error_code=_UNREADABLE)
    file = name if name.endswith(".service") else f"{name}.service"
    for folder in _FOLDERS:
        path = root / folder / "systemd/system" / file
        if path.is_file():
            return path
    raise UsageError(
        f"systemd has no unit {file}: copy deploy/uoarm.service to /etc/systemd/system, or name "
        "another one with --unit",
        error_code=_UNREADABLE,
    )


def read_unit(path: Path) -> Unit:
    """Return a unit file with the drop-ins beside it.

    Raises:
        UsageError: one cannot be read.
    """
    drop_ins = sorted(path.parent.joinpath(f"{path.name}.d").glob("*.conf"))
    texts: list[str] = []
    for file in (path, *drop_ins):
        try:
            texts.append(read_text(file, _MOST_OCTETS))
        except UnreadableFileError as error:
            raise UsageError(f"{file}: {error}", error_code=_UNREADABLE) from error
    return Unit(path, tuple(setting for text in texts for setting in _settings(text)))


def _settings(text: str) -> Iterator[tuple[str, str, str]]:
    section = ""
    kept = [line for line in text.splitlines() if not line.lstrip().startswith(("#", ";"))]
    for line in re.sub(r"\\\n", " ", "\n".join(kept)).splitlines():
        stripped = line.strip()
        if stripped.startswith("[") and stripped.endswith("]"):
            section = stripped[1:-1]
        elif found := _SETTING.fullmatch(line):
            yield section, found[1], found[2].strip()


def _seconds(text: str) -> float | None:
    """Return a time span of systemd in seconds; None: it has no end, or is none."""
    parts = _SPAN.findall(text)
    return sum(float(number) * _UNITS[unit] for number, unit in parts) if parts else None


def _octets(text: str) -> int | None:
    found = _SIZE.fullmatch(text.strip())
    return None if found is None else int(found[1]) * 1024 ** " KMGT".index(found[2] or " ")


@frozen
class _ServeCommand:
    """What `ExecStart` starts.

    Attributes:
        options: of `uoarm serve`, as they are written.
        configuration: the file; None where none is named.
    """

    options: Mapping[str, Any]
    configuration: Path | None


class _Examination:
    """Looks at one unit; each look yields what it finds.

    Args:
        look: returns owner and rights of a path, as `os.stat`.
    """

    def __init__(self, unit: Unit, look: Callable[[Path], os.stat_result]) -> None:
        self._unit = unit
        self._look = look
        self._command: _ServeCommand | None = None
        self._account: ServiceUser | None = None

    def findings(self) -> Iterator[Finding]:
        """Yield everything, what the later looks need first."""
        for check in (
            self._start,
            self._user,
            self._configuration,
            self._secrets,
            self._ports,
            self._readiness,
            self._stopping,
            self._memory,
            self._state,
            self._confinement,
            self._systemd,
        ):
            name = check.__name__.lstrip("_")
            found: list[Finding] = []
            try:
                found.extend(Finding(name, level, text) for level, text in check())
            except OSError as error:
                text = f"{error.filename} cannot be looked at: {error.strerror}; ask as root"
                found.append(Finding(name, Level.WARNING, text))
            bad = [finding for finding in found if finding.level is not Level.OK]
            yield from bad or found

    def _start(self) -> Iterator[tuple[Level, str]]:
        try:
            words = shlex.split(self._unit.value("ExecStart").lstrip("@-:+!"))
        except ValueError as error:
            yield Level.ERROR, f"ExecStart cannot be read: {error}"
            return
        if not words:
            yield Level.ERROR, "ExecStart is missing: the unit starts nothing"
            return
        program = Path(words[0])
        if not os.access(program, os.X_OK):
            yield Level.ERROR, f"ExecStart: {program} is no program that can be run here"
        if "serve" not in words:
            yield Level.WARNING, "ExecStart is not `uoarm serve`: its options are not looked at"
            return
        try:
            options = options_of_serve(words[words.index("serve") + 1 :])
        except click.UsageError as error:
            yield Level.ERROR, f"ExecStart: uoarm serve refuses its options: {error.message}"
            return
        folder = Path(self._unit.value("WorkingDirectory") or "/")
        file = options.get("place") or options.get("file")
        self._command = _ServeCommand(options, None if file is None else folder / file)
        yield Level.OK, " ".join(words)

    def _user(self) -> Iterator[tuple[Level, str]]:
        name = self._unit.value("User")
        if self._unit.is_on("DynamicUser"):
            yield Level.WARNING, "DynamicUser: files of the service change their owner; name a User"
            return
        if not name:
            yield Level.ERROR, "User is missing: the server runs as root; give it a user of its own"
            return
        try:
            self._account = _account(name, self._unit)
        except KeyError as error:
            yield Level.ERROR, f"there is no {error.args[0]} here: make it, as docs/deploy.md says"
            return
        if self._account.uid == 0:
            yield Level.ERROR, f"User={name} is root: give the server a user of its own"
        yield Level.OK, f"{name}, {self._account.uid}"

    def _configuration(self) -> Iterator[tuple[Level, str]]:
        if self._command is None:
            return
        file = self._command.configuration
        if file is None:
            yield Level.ERROR, "ExecStart names no configuration file"
            return
        if not self._is_file(file):
            yield Level.ERROR, f"there is no configuration file {file}"
            return
        yield from self._require_readable(file)
        for path in (file, *file.parents):
            found = self._look(path)
            writers = found.st_mode & (_GROUP | _ALL)
            if writers & _ALL and not found.st_mode & stat.S_ISVTX:
                yield (
                    Level.ERROR,
                    f"everyone may write {path}, which names code that runs: chmod o-w",
                )
        account = self._account
        if account is not None and self._may(file, account, os.W_OK):
            what = f"{account.name} may write {file}, which names code that runs"
            yield Level.WARNING, f"{what}: let root own it, unless changes are kept in it"
        yield Level.OK, str(file)

    def _secrets(self) -> Iterator[tuple[Level, str]]:
        if self._command is None:
            return
        options, file = self._command.options, self._command.configuration
        secrets = [Path(options[name]) for name in ("key", "access") if options.get(name)]
        if file is not None and os.path.isfile(file):
            from uoarm.config import load  # noqa: PLC0415 - slow, and of one look

            try:
                robot = load(file)
            except UoarmError as error:
                first = str(error).splitlines()[0]
                yield Level.WARNING, f"which secrets {file} names is not known: {first}"
            else:
                for bridge in robot.bridges.values():
                    secrets += _secret_files(bridge.options, Path(bridge.folder))
        for secret in dict.fromkeys(secrets):
            if not self._is_file(secret):
                yield Level.ERROR, f"there is no file {secret}"
                continue
            yield from self._require_readable(secret)
            if self._look(secret).st_mode & 0o007:
                yield Level.ERROR, f"everyone may read {secret}: chmod 640, with a group of its own"
        yield Level.OK, f"{len(secrets)} files" if secrets else "no files of secrets are named"

    def _ports(self) -> Iterator[tuple[Level, str]]:
        if self._command is None:
            return
        options = self._command.options
        host = str(options.get("host") or "127.0.0.1")
        given = [options.get("port") or "9080", *(options.get("front_end_ports") or ())]
        given.append(options.get("rosbridge_port") or "0")
        ports: list[int] = []
        for text in given:
            number = text.rpartition("=")[2]
            if number.isdecimal() and int(number) <= _LAST_PORT:
                ports.append(int(number))
            else:
                yield Level.ERROR, f"{text}: expected a port, 0 to {_LAST_PORT}"
        if host not in _LOOPBACK and not options.get("access"):
            yield Level.ERROR, f"--host {host} without --access: the server refuses to start"
        if host not in _LOOPBACK and not (options.get("tls") or options.get("certificate")):
            yield Level.WARNING, f"--host {host} without TLS: tokens can be read on the network"
        for port in ports:
            if 0 < port < _LEAST_FREE_PORT and "CAP_NET_BIND_SERVICE" not in " ".join(
                self._unit.values("AmbientCapabilities")
            ):
                yield Level.ERROR, f"port {port} is root's: take another, or AmbientCapabilities"
            elif port and (cause := _taken(host, port)):
                if _is_active(self._unit.path.name):
                    continue  # by the service itself, which runs
                yield Level.ERROR, f"port {port} of {host} cannot be listened on: {cause}"
        yield Level.OK, ", ".join(f"{host}:{port}" for port in ports if port)

    def _readiness(self) -> Iterator[tuple[Level, str]]:
        unit, watchdog = self._unit, self._unit.value("WatchdogSec")
        seconds = _seconds(watchdog)
        is_notified = unit.value("Type") in {"notify", "notify-reload"}
        if not is_notified:
            text = "Type is not notify: systemd takes the server for started before it listens"
            yield Level.ERROR if seconds else Level.WARNING, text
        if unit.value("NotifyAccess", "main") == "none":
            yield Level.ERROR, "NotifyAccess=none: systemd receives neither readiness nor watchdog"
        if not seconds:
            yield Level.WARNING, "WatchdogSec is missing: a loop that hangs is not noticed; take 10"
        elif seconds < _LEAST_WATCHDOG:
            yield Level.WARNING, f"WatchdogSec={watchdog} kills a server on a busy machine; take 10"
        if unit.value("Restart", "no") not in {"on-failure", "always", "on-abnormal"}:
            yield Level.WARNING, "Restart is off: what dies stays down; take on-failure"
        yield Level.OK, f"watchdog {watchdog}, restart {unit.value('Restart')}"

    def _stopping(self) -> Iterator[tuple[Level, str]]:
        unit = self._unit
        limit = _seconds(unit.value("TimeoutStopSec", "90"))
        if limit is not None and limit < _LEAST_STOP:
            yield (
                Level.WARNING,
                f"TimeoutStopSec={limit:g} may kill the server before inputs are stopped; take 30",
            )
        if unit.value("KillMode", "control-group") not in {"mixed", "process"}:
            yield (
                Level.WARNING,
                "KillMode ends hosts before the manager has stopped what moves; take mixed",
            )
        if "HUP" not in unit.value("ExecReload"):
            yield Level.WARNING, "ExecReload does not send HUP: `systemctl reload` does nothing"
        yield Level.OK, "inputs are stopped first"

    def _memory(self) -> Iterator[tuple[Level, str]]:
        limits = {name: self._unit.value(name) for name in ("MemoryHigh", "MemoryMax")}
        given = {name: text for name, text in limits.items() if text and text != "infinity"}
        if not given:
            remedy = "take what the robot needs under load, and half as much again"
            yield Level.WARNING, f"MemoryMax is missing: a leak takes the whole machine; {remedy}"
        for name, text in given.items():
            octets = _octets(text)
            if octets is not None and octets < _LEAST_MEMORY:
                yield Level.WARNING, f"{name}={text} is little: a server alone takes up to 256M"
        yield Level.OK, ", ".join(f"{name} {text}" for name, text in given.items())

    def _state(self) -> Iterator[tuple[Level, str]]:
        unit, written = self._unit, []
        variables: dict[str, str] = {}
        for line in unit.values("Environment"):
            try:
                words = [word.partition("=") for word in shlex.split(line)]
                variables.update((name, value) for name, equals, value in words if equals)
            except ValueError as error:
                yield Level.ERROR, f"Environment={line} cannot be read: {error}"
        if "XDG_STATE_HOME" in variables:
            written.append(variables["XDG_STATE_HOME"])
        else:
            yield (
                Level.WARNING,
                "XDG_STATE_HOME is not set: that the robot was stopped is kept in the user's home",
            )
        if self._command is not None:
            options = self._command.options
            named = (options.get(name) for name in ("audit", "recordings"))
            written += [str(path) for path in named if path]
        if unit.value("ProtectSystem") != "strict":
            yield Level.OK, ", ".join(written)
            return
        folders = {f"/var/lib/{name}" for name in unit.value("StateDirectory").split()}
        folders |= {f"/var/log/{name}" for name in unit.value("LogsDirectory").split()}
        folders |= {
            path.lstrip("-+") for line in unit.values("ReadWritePaths") for path in line.split()
        }
        folders |= {"/tmp", "/var/tmp"} if unit.is_on("PrivateTmp") else set()  # noqa: S108
        for path in written:
            if not any(Path(path).is_relative_to(folder) for folder in folders):
                yield (
                    Level.ERROR,
                    f"{path} cannot be written: ProtectSystem=strict; add it to ReadWritePaths",
                )
        yield Level.OK, ", ".join(written)

    def _confinement(self) -> Iterator[tuple[Level, str]]:
        unit = self._unit
        if not unit.is_on("NoNewPrivileges"):
            yield Level.WARNING, "NoNewPrivileges is off: programs that it starts may gain rights"
        if unit.value("ProtectSystem") not in {"strict", "full"}:
            yield Level.WARNING, "ProtectSystem is off: the server may change the system's files"
        yield Level.OK, "NoNewPrivileges, ProtectSystem"

    def _systemd(self) -> Iterator[tuple[Level, str]]:
        program = shutil.which("systemd-analyze")
        if program is None:
            yield Level.OK, "systemd-analyze is not here: the unit's words were not checked"
            return
        try:
            done = subprocess.run(  # noqa: S603 - systemd's own, found on the PATH
                [program, "verify", str(self._unit.path)],
                capture_output=True,
                text=True,
                errors="replace",
                timeout=_SYSTEMD_SECONDS,
                check=False,
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            yield Level.WARNING, f"systemd-analyze could not be asked: {reason_of(error)}"
            return
        for line in done.stderr.splitlines():
            if self._unit.path.name in line:
                yield Level.ERROR if done.returncode else Level.WARNING, line.strip()
        yield Level.OK, "systemd-analyze verify has nothing to say"

    def _require_readable(self, file: Path) -> Iterator[tuple[Level, str]]:
        account = self._account
        if account is None:
            return
        for folder in reversed(file.absolute().parents):
            if not self._may(folder, account, os.X_OK):
                yield Level.ERROR, f"{account.name} cannot enter {folder}, where {file.name} is"
                return
        if not self._may(file, account, os.R_OK):
            yield Level.ERROR, f"{account.name} cannot read {file}: give it to its group, chmod 640"

    def _is_file(self, path: Path) -> bool:
        try:
            return stat.S_ISREG(self._look(path).st_mode)
        except PermissionError:  # it may be one; `os.path.isfile` would say that it is none
            raise
        except (OSError, ValueError):
            return False

    def _may(self, path: Path, account: ServiceUser, right: int) -> bool:
        found = self._look(path)
        if account.uid == 0:
            return True
        shift = 6 if found.st_uid == account.uid else 3 if found.st_gid in account.groups else 0
        return bool(found.st_mode >> shift & right)


def examine(unit: Unit, look: Callable[[Path], os.stat_result] = os.stat) -> tuple[Finding, ...]:
    """Return what of a unit holds, and what does not with what to do.

    Args:
        unit: as `read_unit` returns it.
        look: returns owner and rights of a path.
    """
    return tuple(_Examination(unit, look).findings())


def options_of_serve(words: list[str]) -> Mapping[str, Any]:
    """Return the options of `uoarm serve` as they are written.

    Raises:
        click.UsageError: it has not got such an option.
    """
    from uoarm.cli._main import main  # noqa: PLC0415 - imports every command's name

    root = click.Context(main, info_name="uoarm")
    command = main.get_command(root, "serve")
    assert command is not None
    context = click.Context(command, parent=root, info_name="serve")
    given, _, _ = command.make_parser(context).parse_args(list(words))
    # A word that is not there is None, or an object of click's own.
    return {name: value for name, value in given.items() if isinstance(value, str | list)}


def _secret_files(options: Any, folder: Path, name: str = "") -> Iterator[Path]:
    """Yield the files that options name as secrets: by the option's name."""
    if isinstance(options, Mapping):
        for key, value in options.items():
            yield from _secret_files(value, folder, str(key))
    elif isinstance(options, str) and _SECRET.search(name):
        path = folder / os.path.expanduser(options)  # noqa: PTH111 - `~` alone stays
        if name.endswith("_file") or os.path.isfile(path):
            yield path


def _account(name: str, unit: Unit) -> ServiceUser:
    """Return the account of a user, with the groups that a unit gives it.

    Raises:
        KeyError: there is no such user or group; its first argument says which.
    """
    try:
        entry = pwd.getpwuid(int(name)) if name.isdecimal() else pwd.getpwnam(name)
    except KeyError:
        raise KeyError(f"user {name!r}") from None
    groups = set(os.getgrouplist(entry.pw_name, entry.pw_gid))
    extra = [unit.value("Group"), *" ".join(unit.values("SupplementaryGroups")).split()]
    for group in filter(None, extra):
        try:
            groups.add(int(group) if group.isdecimal() else grp.getgrnam(group).gr_gid)
        except KeyError:
            raise KeyError(f"group {group!r}") from None
    return ServiceUser(entry.pw_name, entry.pw_uid, frozenset(groups))


def _taken(host: str, port: int) -> str:
    """Return why a port cannot be listened on; empty where it can."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as line:
        line.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            line.bind((host, port))
        except OSError as error:
            if error.errno == errno.EACCES:
                return ""  # who asks has no right to; the service may have it
            return error.strerror or str(error)
    return ""


def _is_active(unit: str) -> bool:
    program = shutil.which("systemctl")
    if program is None:
        return False
    with suppress(OSError, subprocess.TimeoutExpired):
        done = subprocess.run(  # noqa: S603 - systemd's own, found on the PATH
            [program, "is-active", "--quiet", unit],
            capture_output=True,
            timeout=_SYSTEMD_SECONDS,
            check=False,
        )
        return done.returncode == 0
    return False
