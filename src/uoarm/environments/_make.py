"""Making an environment: with uv where it is installed, else with venv and pip."""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import zipfile
from collections import deque
from collections.abc import Callable, Iterable
from functools import partial
from importlib.metadata import Distribution, entry_points
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory

from uoarm._origin import installed, origin_of
from uoarm._raised import on_failure, reason_of
from uoarm._spelling import did_you_mean
from uoarm._support.files import write_whole
from uoarm.bridge._registry import known_plugins, plugins_of_core
from uoarm.environments._environment import (
    MARK,
    PluginEnvironmentError,
    environment_folder,
    environment_python,
    extras_in,
    passed_on,
)

# Written by what installs a wheel, not part of one.
_LEFT_OUT = frozenset({"RECORD", "INSTALLER", "REQUESTED", "direct_url.json"})
_GROUP = "uoarm.bridges"
_CORE = "uoarm"
# `ros-jazzy-rclpy; extra == 'jazzy'`: the middleware that an extra brings in this version.
_BROUGHT = re.compile(r"([A-Za-z0-9._-]+)[^;]*;.*\bextra == ['\"]([^'\"]+)")
_WITH_EXTRAS = re.compile(r"([A-Za-z0-9._-]+)\[([^\]]*)\]")
_PINNED = re.compile(r"([A-Za-z0-9._-]+)(\[[^\]]*\])?==([^ ;]+)")
_LIMIT_SECONDS = 1800.0
_SHOWN = 15
Progress = Callable[[str], None]
"""Takes one line of progress."""


def repack(found: Distribution, folder: Path) -> Path | None:
    """Write the wheel of a pure Python distribution into a folder.

    Commands are left out: whatever installs the wheel makes them of the entry points.

    Returns:
        The wheel; None where its files cannot be one: they are compiled, or lie elsewhere.
    """
    about = found.read_text("WHEEL") or ""
    if "Root-Is-Purelib: true" not in about or found.files is None:
        return None
    name = found.name.replace("-", "_")
    info = f"{name}-{found.version}.dist-info"
    wheel = folder / f"{name}-{found.version}-py3-none-any.whl"
    record = io.StringIO()
    rows = csv.writer(record, lineterminator="\n")
    with zipfile.ZipFile(wheel, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry in found.files:
            if not _belongs(entry):
                continue
            octets = Path(str(entry.locate())).read_bytes()
            digest = base64.urlsafe_b64encode(hashlib.sha256(octets).digest()).rstrip(b"=")
            rows.writerow([entry.as_posix(), f"sha256={digest.decode()}", len(octets)])
            archive.writestr(entry.as_posix(), octets)
        rows.writerow([f"{info}/RECORD", "", ""])
        archive.writestr(f"{info}/RECORD", record.getvalue())
    return wheel


def _belongs(entry: PurePosixPath) -> bool:
    first = entry.parts[0]
    if first == ".." or entry.is_absolute() or "__pycache__" in entry.parts:
        return False
    return not (first.endswith(".dist-info") and entry.name in _LEFT_OUT)


def requirements(plugin: str, version: str | None, more: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Return the requirements of an environment for one plugin.

    What is installed here as an editable project is that project there, too; anything else is
    pinned to its version, for which `create` gives the files that are installed here.

    Args:
        plugin: name of the bridge type, `ros2`.
        version: version of its middleware, `jazzy`: an extra of the plugin's distribution.
        more: requirements to add, as pip reads them; a path of a project stands for itself.

    Raises:
        PluginError: the plugin is installed here, and says that it has no such version; or it is
            among the further requirements without its version, which nothing would install; or
            what is named is a package or a path, or a plugin of others that is neither installed
            here nor among the further requirements.
    """
    if re.search(r"[^\w.-]|^uoarm-|^$", plugin):
        text = f"{plugin!r} is no name of a plugin: expected one such as mqtt"
        raise PluginEnvironmentError(f"{text}; a package or path goes to --with")
    ours = _requirement(installed(_CORE), _CORE, "hosts")
    point = next((entry for entry in entry_points(group=_GROUP) if entry.name == plugin), None)
    provider = None if point is None else point.dist
    if plugin in plugins_of_core() or (provider is not None and provider.name == _CORE):
        if version is not None:
            raise PluginEnvironmentError(
                f"the plugin {plugin} has no middleware: leave {version!r} out"
            )
        return (ours, *more)
    if provider is not None and version is not None:
        _require_extra(provider, version)
    given = [name for name in more if _names(name, f"uoarm-{plugin}")] if provider is None else []
    if given:
        asks = re.compile(rf"\[([^\]]*,)?\s*{re.escape(version or '')}\s*[,\]]")
        if version is not None and not any(map(asks.search, given)):
            text = f"{given[0]} stands for the plugin, and does not ask for {version!r}"
            raise PluginEnvironmentError(f"{text}: expected [{version}] after its name or path")
        return (ours, *more)
    known = known_plugins()
    if plugin not in known:
        text = f"there is no plugin {plugin!r} (known: {', '.join(known)})"
        hint = did_you_mean(plugin, known) or f"; of others it is added by --with uoarm-{plugin}"
        raise PluginEnvironmentError(f"{text}{hint}")
    return (ours, _requirement(provider, f"uoarm-{plugin}", version), *more)


def handed_on(requirement: str, folder: Path) -> str:
    """Return a requirement with the wheel of what is installed here, where it is pinned to that.

    Only uoarm and its plugins are handed on; everything else comes from an index.

    Args:
        requirement: as `requirements` returns it.
        folder: where the wheel is written.
    """
    pinned = _PINNED.fullmatch(requirement)
    found = None if pinned is None else installed(pinned[1])
    if pinned is None or found is None or found.version != pinned[3] or not _is_ours(found):
        return requirement
    wheel = repack(found, folder)
    return requirement if wheel is None else f"{pinned[1]}{pinned[2] or ''} @ {wheel.as_uri()}"


def extras_of(requirements: Iterable[str]) -> dict[str, list[str]]:
    """Return the extras that requirements name, by project; those of paths are not known."""
    found = (_WITH_EXTRAS.match(requirement) for requirement in requirements)
    return {match[1]: re.findall(r"[A-Za-z0-9._-]+", match[2]) for match in found if match}


def unknown_extra(name: str, extra: str, known: Iterable[str]) -> str:
    """Return that a project has no such extra, and which it has."""
    there = ", ".join(text for text in known if text != "dev")
    what = "distribution" if name.startswith(f"{_CORE}-") else "extra"
    return f"{name} has no {what} {extra!r}: there are {there or 'none'}"


def _require_extra(provider: Distribution, extra: str) -> None:
    """Pip only warns of an extra that a distribution has not."""
    known = provider.metadata.get_all("Provides-Extra") or []
    if extra not in known:
        brought = [_BROUGHT.match(text) for text in provider.requires or ()]
        versions = {found[2] for found in brought if found and f"-{found[2]}-" in found[1]}
        there = [text for text in known if text in versions] or known
        raise PluginEnvironmentError(unknown_extra(provider.name, extra, there))


def _is_ours(found: Distribution) -> bool:
    return found.name == _CORE or any(point.group == _GROUP for point in found.entry_points)


def _requirement(found: Distribution | None, name: str, extra: str | None) -> str:
    if found is not None:
        name = found.name
    wanted = f"{name}[{extra}]" if extra else name
    origin = origin_of(name)
    if origin is not None and (origin.editable or found is None):
        return f"{wanted} @ {origin.path.as_uri()}"
    return wanted if found is None else f"{wanted}=={found.version}"


def _names(requirement: str, project: str) -> bool:
    """Say whether a requirement names a project or is the path of its folder or of its wheel."""
    longer = "(?![A-Za-z0-9]|-[A-Za-z])"  # uoarm-ros2 does not stand for uoarm-ros
    return re.search(re.escape(project) + longer, requirement.replace("_", "-")) is not None


def create(
    name: str,
    requirements: tuple[str, ...],
    *,
    python: str | None = None,
    progress: Progress | None = None,
    uv: str | None = None,
) -> Path:
    """Make an environment and return its interpreter. One that fails is removed again.

    Args:
        name: of the environment, which must not exist.
        requirements: what to install, as pip reads it; uoarm and plugins that are pinned to the
            version that runs here are installed from the files that run here.
        python: version (with uv) or path of the interpreter to build on; None: this one.
        progress: called with each line of output; None: not called.
        uv: path of uv; None: looked for on the path; "": not used.

    Raises:
        PluginError: the name is taken or cannot be one, a step failed, or what was installed has
            no extra of a name that the requirements give; the text has the step, and its last lines
            where they were not announced.
    """
    folder = environment_folder(name)
    if folder.exists():
        raise PluginEnvironmentError(
            f"there is an environment {name!r} already: uoarm env remove {name}"
        )
    found = shutil.which("uv") if uv is None else uv
    base = python or sys.executable
    interpreter = environment_python(name)
    if found:
        make = [found, "venv", "--python", base, str(folder)]
        install = [found, "pip", "install", "--python", str(interpreter)]
    else:
        make = [base, "-m", "venv", str(folder)]
        install = [str(interpreter), "-m", "pip", "install"]
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        _run(make, progress)
        with TemporaryDirectory(prefix="uoarm-wheels-") as wheels:
            given = [handed_on(requirement, Path(wheels)) for requirement in requirements]
            _run([*install, *given], progress)
        _require_extras(interpreter, requirements)
        said = json.dumps({"name": name, "requirements": requirements})
        write_whole(folder / MARK, said.encode())
    except BaseException as error:
        shutil.rmtree(folder, ignore_errors=True)
        if isinstance(error, OSError):
            raise PluginEnvironmentError(
                f"environment {name!r} cannot be made: {reason_of(error)}"
            ) from error
        raise
    return interpreter


def _require_extras(interpreter: Path, requirements: tuple[str, ...]) -> None:
    """Refuse an extra that a project has not: pip and uv only warn of it, and leave it out."""
    wanted = extras_of(requirements)
    for name, known in extras_in(interpreter, wanted).items():
        plain = {_normal(text) for text in known}
        for extra in wanted[name]:
            if _normal(extra) not in plain:
                raise PluginEnvironmentError(unknown_extra(name, extra, known))


def _normal(extra: str) -> str:
    return re.sub("[._-]+", "-", extra).lower()


def _run(step: list[str], progress: Progress | None) -> None:
    """Run one step, handing on what it prints as it prints it."""
    variables = passed_on(os.environ, is_environment=True)
    lines: deque[str] = deque(maxlen=_SHOWN)
    take = lines.append if progress is None else progress
    command = " ".join(step)
    if progress is not None:
        progress(f"$ {command}")
    with subprocess.Popen(  # noqa: S603 - uv, or the interpreter that the operator chose
        step,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=variables,
        start_new_session=True,  # what it starts ends with it: that would hold stdout open
    ) as process:
        end = partial(os.killpg, process.pid, signal.SIGKILL)
        limit = threading.Timer(_LIMIT_SECONDS, end)
        limit.daemon = True
        limit.start()
        try:
            assert process.stdout is not None, "stdout is a pipe"
            with on_failure(end):
                for line in process.stdout:
                    take(line.decode(errors="replace").rstrip())
        finally:
            limit.cancel()
    if process.returncode != 0:
        last = "".join(f"\n{line}" for line in lines)
        raise PluginEnvironmentError(
            f"{command} ended with status {process.returncode}{last and ':'}{last}"
        )
