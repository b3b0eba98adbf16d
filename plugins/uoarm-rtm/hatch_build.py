# ruff: noqa: INP001 - a hook of hatchling beside the package
"""Adds to each wheel what omniidl makes of the IDL files, as the package `_uoarm_rtm_stubs`."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGE = "_uoarm_rtm_stubs"
# omniidl looks for its preprocessor beside the program that it believes to be.
_RUN = "import sys; sys.argv[0] = sys.argv.pop(1); from omniidl.main import main; main()"


def compile_all(idl: Path, into: Path) -> Path:
    """Compile every IDL file of a folder to the package of stubs below `into`; returns it."""
    spec = find_spec("jeteve_omniorb")
    if spec is None or spec.origin is None:
        raise RuntimeError("the stubs are made by omniidl: pip install jeteve-omniorb")
    program = Path(spec.origin).parent / "bin" / "omniidl"
    files = sorted(path.name for path in idl.glob("*.idl"))
    options = ["-bpython", f"-Wbpackage={PACKAGE}", f"-I{idl}", f"-C{into}"]
    command = [sys.executable, "-c", _RUN, str(program), *options, *files]
    done = subprocess.run(  # noqa: S603 - our own interpreter, and files of ours
        command, cwd=idl, capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise RuntimeError(f"omniidl cannot compile {', '.join(files)}: {done.stderr}")
    return into / PACKAGE


class StubsHook(BuildHookInterface[Any]):
    """Has each wheel, an editable one too, take the stubs; the source folders stay as they are."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the IDL files and name the result to the builder."""
        self._folder = TemporaryDirectory()
        idl = Path(self.root) / "src" / "uoarm_rtm" / "idl"
        stubs = compile_all(idl, Path(self._folder.name))
        included = "force_include_editable" if version == "editable" else "force_include"
        build_data[included][str(stubs)] = PACKAGE

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:  # noqa: ARG002 - hatchling's
        """Remove what the wheel has taken."""
        self._folder.cleanup()
