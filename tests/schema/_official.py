"""The official JSON-Schema-Test-Suite, out of the source distribution of ``jsonschema``.

It is asked for by package name at test time and kept in a cache folder (``UOARM_TEST_CACHE``, else
``.cache`` in the repository), never committed.
"""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import subprocess
import sys
import tarfile
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Iterator

PACKAGE = "jsonschema"
VERSION = "4.26.0"
NEWEST = "draft2020-12"
OLDER = {
    "draft2019-09": "https://json-schema.org/draft/2019-09/schema",
    "draft7": "http://json-schema.org/draft-07/schema#",
    "draft6": "http://json-schema.org/draft-06/schema#",
    "draft4": "http://json-schema.org/draft-04/schema#",
}
_INSIDE = f"{PACKAGE}-{VERSION}/json/tests"
_SKIPPED = {"format", "dependencies-compatibility", "format-assertion", "cross-draft"}
"""Optional groups whose outcome the draft leaves open."""
_LEFT_OPEN_BY_OLDER = {"optional/content", "optional/zeroTerminatedFloats"}


class SuiteMissingError(RuntimeError):
    """The suite is not in the cache and could not be fetched."""


class Group(NamedTuple):
    """One schema of the suite with its instances."""

    keyword: str
    description: str
    schema: bool | dict[str, object]
    cases: tuple[tuple[object, bool], ...]


def groups(draft: str = NEWEST) -> tuple[Group, ...]:
    """All groups of a draft, fetched first when they are not in the cache.

    Those of older drafts name their draft.
    """
    folder = cache_folder() / f"json-schema-test-suites-{VERSION}"
    folder.parent.mkdir(parents=True, exist_ok=True)
    with (folder.parent / "lock").open("w") as lock:  # all workers come at the same time
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.is_dir():
            _fetch(folder)
    found = _read(folder / draft)
    if draft == NEWEST:
        return tuple(found)
    return tuple(
        group._replace(schema=_naming(group.schema, OLDER[draft]))
        for group in found
        if group.keyword not in _LEFT_OPEN_BY_OLDER
    )


def _naming(schema: bool | dict[str, object], draft: str) -> bool | dict[str, object]:
    return schema if isinstance(schema, bool) else {"$schema": draft, **schema}


def cache_folder() -> Path:
    default = Path(__file__).parents[2] / ".cache"
    return Path(os.environ.get("UOARM_TEST_CACHE", default))


def _fetch(folder: Path) -> None:
    with TemporaryDirectory(dir=folder.parent) as own:
        _unpack(Path(own), folder)


def _unpack(downloads: Path, folder: Path) -> None:
    command = [
        *_pip(), "download", "--quiet", "--disable-pip-version-check", "--no-deps",
        "--no-binary", PACKAGE, "--dest", str(downloads), f"{PACKAGE}=={VERSION}",
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    archive = downloads / f"{PACKAGE}-{VERSION}.tar.gz"
    if done.returncode or not archive.is_file():
        raise SuiteMissingError(
            f"the source distribution of {PACKAGE} {VERSION}, which carries the official suite,"
            f" could not be fetched: {done.stderr.strip()[-400:]}"
        )
    with tarfile.open(archive) as tar:
        members = [
            member
            for member in tar.getmembers()
            if member.isfile()
            and member.name.startswith(tuple(f"{_INSIDE}/{name}/" for name in (NEWEST, *OLDER)))
            and ".." not in member.name
        ]
        for member in members:
            source = tar.extractfile(member)
            assert source is not None
            target = downloads / "tests" / Path(member.name).relative_to(_INSIDE)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(source.read())
    if not members:
        raise SuiteMissingError(f"{archive.name} no longer carries {_INSIDE}")
    (downloads / "tests").rename(folder)


def _pip() -> list[str]:
    if find_spec("pip") is not None:
        return [sys.executable, "-m", "pip"]
    for name in ("pip3", "pip"):
        if found := shutil.which(name):
            return [found]
    if uv := shutil.which("uv"):
        return [uv, "tool", "run", "--quiet", "pip"]
    raise SuiteMissingError("neither pip nor uv is here to fetch the official suite with")


def _read(folder: Path) -> Iterator[Group]:
    for path in sorted(folder.rglob("*.json")):
        if path.stem in _SKIPPED or "format" in path.parent.name:
            continue
        keyword = f"optional/{path.stem}" if path.parent.name == "optional" else path.stem
        for group in json.loads(path.read_text(encoding="utf-8")):
            cases = tuple((case["data"], case["valid"]) for case in group["tests"])
            yield Group(keyword, group["description"], group["schema"], cases)
