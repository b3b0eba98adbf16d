"""Making an environment: with uv where it is installed, else with venv and pip."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

from uoarm._whole_file import write_whole
from uoarm.environments._doctor import extras_in
from uoarm.environments._place import MARK, environment_folder, environment_python
from uoarm.environments._requirements import extras_of, handed_on, unknown_extra
from uoarm.errors import PluginError

__all__ = ["create"]

_LIMIT_SECONDS = 1800.0
_SHOWN = 15
_TRACES = ("PYTHONHOME", "PYTHONPATH", "VIRTUAL_ENV")

Tell = Callable[[str], None]
"""Takes one line of progress."""


def create(
    name: str,
    requirements: tuple[str, ...],
    *,
    python: str | None = None,
    tell: Tell | None = None,
    uv: str | None = None,
) -> Path:
    """Make an environment and return its interpreter. One that fails is removed again.

    Args:
        name: of the environment, which must not exist.
        requirements: what to install, as pip reads it; uoarm and plugins that are pinned to the
            version that runs here are installed from the files that run here.
        python: version (with uv) or path of the interpreter to build on; None: this one.
        tell: told each line of progress; None: nobody is.
        uv: path of uv; None: looked for on the path; "": not used.

    Raises:
        PluginError: the name is taken or cannot be one, a step failed, or what was installed has
            no extra of a name that the requirements give; the text has the step, and its last lines
            where nobody was told them.
    """
    folder = environment_folder(name)
    if folder.exists():
        raise PluginError(f"there is an environment {name!r} already: uoarm env remove {name}")
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
        _run(make, tell)
        with TemporaryDirectory(prefix="uoarm-wheels-") as wheels:
            given = [handed_on(requirement, Path(wheels)) for requirement in requirements]
            _run([*install, *given], tell)
        _require_extras(interpreter, requirements)
        said = json.dumps({"name": name, "requirements": requirements})
        write_whole(folder / MARK, said.encode())
    except BaseException as error:
        shutil.rmtree(folder, ignore_errors=True)
        if isinstance(error, OSError):
            raise PluginError(f"environment {name!r} cannot be made: {error}") from error
        raise
    return interpreter


def _require_extras(interpreter: Path, requirements: tuple[str, ...]) -> None:
    """Refuse an extra that a project has not: pip and uv only warn of it, and leave it out."""
    wanted = extras_of(requirements)
    for name, known in extras_in(interpreter, wanted).items():
        plain = {_normal(text) for text in known}
        for extra in wanted[name]:
            if _normal(extra) not in plain:
                raise PluginError(unknown_extra(name, extra, known))


def _normal(extra: str) -> str:
    return re.sub("[._-]+", "-", extra).lower()


def _run(step: list[str], tell: Tell | None) -> None:
    """Run one step, telling what it prints as it prints it."""
    variables = {key: value for key, value in os.environ.items() if key not in _TRACES}
    lines: deque[str] = deque(maxlen=_SHOWN)
    take = lines.append if tell is None else tell
    command = " ".join(step)
    if tell is not None:
        tell(f"$ {command}")
    with subprocess.Popen(  # noqa: S603 - uv, or the interpreter that the operator chose
        step,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env=variables,
    ) as process:
        limit = threading.Timer(_LIMIT_SECONDS, process.kill)
        limit.daemon = True
        limit.start()
        try:
            assert process.stdout is not None, "stdout is a pipe"
            for line in process.stdout:
                take(line.decode(errors="replace").rstrip())
        except BaseException:
            process.kill()
            raise
        finally:
            limit.cancel()
    if process.returncode != 0:
        last = "".join(f"\n{line}" for line in lines)
        raise PluginError(f"{command} ended with status {process.returncode}{last and ':'}{last}")
