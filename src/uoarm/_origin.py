"""Where installed distributions came from, and what installs more of the same.

A hint must work where it is read. In an environment that was made from a checkout or from wheel
files, names of an index would be another uoarm's, or of no package.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from attrs import frozen

if TYPE_CHECKING:
    from importlib.metadata import Distribution

_CORE = "uoarm"
# An extra that brings another distribution of ours, which pip must not look for on an index.
_BROUGHT = {(_CORE, "server"): "uoarm-rosbridge"}


@frozen
class Origin:
    """What a distribution was installed from, or could be.

    Attributes:
        path: a project's folder, or a wheel file; it exists.
        editable: whether the folder itself is what runs.
    """

    path: Path
    editable: bool = False


def installed(name: str) -> Distribution | None:
    from importlib.metadata import (  # noqa: PLC0415 - slow import
        PackageNotFoundError,
        distribution,
    )

    try:
        return distribution(name)
    except PackageNotFoundError:
        return None


def origin_of(name: str) -> Origin | None:
    """Return what installs a distribution of ours; None: its name, from an index.

    That is what it was installed from (PEP 610), as long as it is still there. One that is not
    installed is looked for beside the core: among the plugins of its checkout, or its wheels.
    """
    found = installed(name)
    if found is not None:
        return _recorded(found)
    core = None if name == _CORE else origin_of(_CORE)
    if core is None:
        return None
    if core.path.is_dir():
        project = core.path / "plugins" / name
        return Origin(project, core.editable) if (project / "pyproject.toml").is_file() else None
    wheels = sorted(core.path.parent.glob(f"{name.replace('-', '_')}-*.whl"))
    return Origin(wheels[-1]) if wheels else None


def install_command(name: str, extra: str = "") -> str:
    """Return the command that installs a distribution of ours with one of its extras."""
    wanted = [_argument(name, extra)]
    brought = _BROUGHT.get((name, extra))
    if brought is not None and installed(brought) is None and origin_of(brought) is not None:
        wanted.append(_argument(brought, ""))
    return f"pip install {' '.join(wanted)}"


@contextmanager
def requiring(extra: str, what: str) -> Iterator[None]:
    """Import what needs an extra; where one of its packages is missing, the error says so.

    Args:
        extra: of the core.
        what: needs it, for the error's text.

    Raises:
        ImportError: as the import has it, but with the command that installs the extra.
    """
    try:
        yield
    except ImportError as error:
        text = f"{what} needs: {install_command(_CORE, extra)} ({error})"
        raise type(error)(text, name=error.name, path=error.path) from error


def _argument(name: str, extra: str) -> str:
    origin = origin_of(name)
    target = name if origin is None else str(origin.path)
    option = "-e " if origin is not None and origin.editable else ""
    return f"{option}{shlex.quote(f'{target}[{extra}]' if extra else target)}"


def _recorded(found: Distribution) -> Origin | None:
    from urllib.parse import unquote, urlsplit  # noqa: PLC0415 - slow import

    said = json.loads(found.read_text("direct_url.json") or "{}")
    url = urlsplit(str(said.get("url", "")))
    path = Path(unquote(url.path))
    if url.scheme != "file" or not path.exists():
        return None
    return Origin(path, editable=said.get("dir_info", {}).get("editable", False) is True)
