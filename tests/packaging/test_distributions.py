"""What is handed out: source archives that hold their own only, wheels that build alike twice."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import zipfile
from collections.abc import Callable, Iterable, Iterator
from email.message import Message
from email.parser import Parser
from hashlib import sha256
from pathlib import Path

import pytest

pytest.importorskip("hatchling", reason="hatchling builds the distributions: pip install .[dev]")

ROOT = Path(__file__).parents[2]
PROJECTS = {
    "uoarm": ROOT,
    **{folder.name: folder for folder in sorted((ROOT / "plugins").glob("uoarm-*"))},
}
PARTS = ("pyproject.toml", ".gitignore", "README.md", "CHANGELOG.md", "LICENSE", "hatch_build.py")
FOLDERS = ("src", "tests", "docs", "plugins", "examples")
STUBS = "_uoarm_rtm_stubs/"  # made of the IDL files as the wheel is built
Built = dict[str, tuple[Path, Path]]


def projects(names: Iterable[str]) -> pytest.MarkDecorator:
    """Run a test for each of these projects, where what builds it is here."""
    needs = {"uoarm-rtm": pytest.mark.needs("rtm")}  # the IDL compiler
    return pytest.mark.parametrize(
        "name", [pytest.param(name, marks=needs.get(name, ())) for name in names]
    )


def copied(project: Path, target: Path) -> Path:
    """Copy what belongs to a project, so that files have other times and other rights."""
    target.mkdir()
    for name in PARTS:
        if (project / name).exists():
            shutil.copyfile(project / name, target / name)
    ignored = shutil.ignore_patterns("__pycache__", ".*_cache", ".hypothesis", ".venv")
    for name in FOLDERS:
        if (project / name).exists():
            shutil.copytree(
                project / name, target / name, ignore=ignored, copy_function=shutil.copyfile
            )
    return target


def build(project: Path, into: Path, umask: int) -> tuple[Path, Path]:
    """Build the source archive and the wheel of a project."""
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(into)]
    variables = {**os.environ, "SOURCE_DATE_EPOCH": "1700000000", "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run(
        command,
        cwd=project,
        env=variables,
        umask=umask,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    [source], [wheel] = into.glob("*.tar.gz"), into.glob("*.whl")
    return source, wheel


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Path, Path]]:
    """Return the distributions of a project, built once."""
    ready: Built = {}

    def of(name: str) -> tuple[Path, Path]:
        if name not in ready:
            ready[name] = build(PROJECTS[name], tmp_path_factory.mktemp(name), 0o022)
        return ready[name]

    return of


def metadata(wheel: Path) -> Message:
    with zipfile.ZipFile(wheel) as archive:
        [name] = [text for text in archive.namelist() if text.endswith(".dist-info/METADATA")]
        return Parser().parsestr(archive.read(name).decode())


def entries(source: Path) -> Iterator[str]:
    """Yield the files of a source archive, below its one folder."""
    with tarfile.open(source) as archive:
        for name in archive.getnames():
            yield name.partition("/")[2]


@projects(PROJECTS)
def test_a_source_archive_holds_its_own_project_only(
    name: str, built: Callable[[str], tuple[Path, Path]]
) -> None:
    allowed = {"src", "tests", "docs", "PKG-INFO", *PARTS}
    package = name.replace("-", "_")
    for entry in entries(built(name)[0]):
        first, _, rest = entry.partition("/")
        assert first in allowed, entry
        own = (f"{package}/", f"_{package}_command.py")
        assert first != "src" or rest.startswith(own), entry


@projects(PROJECTS)
def test_a_source_archive_holds_what_its_wheel_is_built_from(
    name: str, built: Callable[[str], tuple[Path, Path]]
) -> None:
    source, wheel = built(name)
    there = set(entries(source))
    with zipfile.ZipFile(wheel) as archive:
        modules = [name for name in archive.namelist() if ".dist-info/" not in name]
    assert {f"src/{module}" for module in modules if not module.startswith(STUBS)} <= there


@pytest.mark.needs("rtm")
def test_the_wheel_of_openrtm_alone_has_stubs_of_every_idl_file(
    built: Callable[[str], tuple[Path, Path]],
) -> None:
    source, wheel = built("uoarm-rtm")
    assert not [entry for entry in entries(source) if "_stubs" in entry]
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    idl = [Path(name).stem for name in names if name.endswith(".idl")]
    assert idl
    assert {f"{STUBS}{stem}_idl.py" for stem in idl} <= set(names)


@projects(PROJECTS)
def test_the_same_files_build_into_the_same_octets(
    name: str, built: Callable[[str], tuple[Path, Path]], tmp_path: Path
) -> None:
    shutil.copyfile(ROOT / ".gitignore", tmp_path / ".gitignore")  # it is in source archives, too
    project = copied(PROJECTS[name], tmp_path / "elsewhere")
    (tmp_path / "out").mkdir()
    again = build(project, tmp_path / "out", 0o077)
    digests = [
        [sha256(path.read_bytes()).hexdigest() for path in pair] for pair in (built(name), again)
    ]
    assert digests[0] == digests[1]


@projects(PROJECTS)
def test_the_metadata_say_whose_it_is_and_where_it_runs(
    name: str, built: Callable[[str], tuple[Path, Path]]
) -> None:
    report = metadata(built(name)[1])
    assert report["Author"] == "the uoarm developers"
    assert report["License-Expression"] == "Apache-2.0"
    classifiers = report.get_all("Classifier") or []
    assert "Operating System :: POSIX :: Linux" in classifiers
    assert "Programming Language :: Python :: 3.13" in classifiers


@projects(PROJECTS)
def test_the_page_of_an_index_links_to_nothing_that_lies_in_the_repository(
    name: str, built: Callable[[str], tuple[Path, Path]]
) -> None:
    page = metadata(built(name)[1]).get_payload()
    assert isinstance(page, str)
    assert page.startswith(f"# {name}")
    links = re.findall(r"\]\(([^)]*)\)", page)
    assert not [link for link in links if not link.startswith("https://")]


@projects(name for name in PROJECTS if name != "uoarm")
def test_a_plugin_bounds_the_core_below_and_above(
    name: str, built: Callable[[str], tuple[Path, Path]]
) -> None:
    needs = metadata(built(name)[1]).get_all("Requires-Dist") or []
    [core] = [need for need in needs if re.match(r"uoarm[<>=]", need)]
    assert set(core.removeprefix("uoarm").split(",")) == {">=0.1", "<0.2"}


def test_the_extras_do_not_bring_two_builds_of_one_opencv(
    built: Callable[[str], tuple[Path, Path]],
) -> None:
    needs = metadata(built("uoarm")[1]).get_all("Requires-Dist") or []
    vision = [need for need in needs if need.startswith("opencv") and need.endswith("== 'vision'")]
    assert [name.partition("<")[0] for name in vision] == ["opencv-python-headless"]
