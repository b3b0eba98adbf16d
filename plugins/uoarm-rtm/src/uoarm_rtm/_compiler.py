"""The IDL compiler: omniidl of the installed omniORB, run as a process of its own.

It runs apart because its front end is C code with global state, fed by people's files.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from uoarm.errors import BridgeError, BridgeTimeoutError, FailureReason

__all__ = ["OUR_IDL", "compile_idl", "omniorb_programs"]

OUR_IDL = Path(__file__).parent / "idl"

_LIMIT_SECONDS = 20.0
# The back end lies apart: in our package its import would be that of uoarm, ten times the
# compiler's own work.
_BACK_END = Path(__file__).parent / "_back_end"
# omniidl looks for its preprocessor beside the program that it believes to be.
_RUN = "import sys; sys.argv[0] = sys.argv.pop(1); from omniidl.main import main; main()"


def omniorb_programs() -> Path | None:
    """Return the folder in which the Python distribution of omniORB keeps its programs."""
    spec = find_spec("jeteve_omniorb")
    if spec is None or spec.origin is None:
        return None
    return Path(spec.origin).parent / "bin"


def compile_idl(
    files: Sequence[str], into: Path, *, package: str, directory: Path, names: Path | None = None
) -> None:
    """Compile IDL files to Python stubs; takes about 0.1 s.

    Args:
        files: names of files below `directory`.
        into: existing folder that takes the package.
        package: dotted name of the package that the stubs live in.
        directory: where the files are; `#include` finds files there and ours.
        names: file that takes the parameter names of operations, as our back end writes them;
            with it, what is included goes into the same stubs.

    Raises:
        BridgeError: BAD_ENDPOINT when the IDL is wrong, with the compiler's lines;
            UNAVAILABLE when the compiler cannot be started.
        BridgeTimeoutError: the compiler took longer than 20 s.
    """
    programs = omniorb_programs()
    program = str(programs / "omniidl") if programs is not None else "omniidl"
    command = [
        *(sys.executable, "-c", _RUN, program, "-bpython", f"-Wbpackage={package}"),
        *(
            ("-Wbinline", f"-p{_BACK_END}", "-buoarm_idl_names", f"-Wbfile={names}")
            if names
            else ()
        ),
        *(f"-I{directory}", f"-I{OUR_IDL}", f"-C{into}", *files),
    ]
    try:
        done = subprocess.run(  # noqa: S603 - our own interpreter, and arguments of ours
            command,
            cwd=directory,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_LIMIT_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        text = f"compiling {', '.join(files)} took longer than {_LIMIT_SECONDS:g} s"
        raise BridgeTimeoutError(text) from None
    except OSError as error:
        text = f"the IDL compiler cannot be started: {error}"
        raise BridgeError(text, FailureReason.UNAVAILABLE) from error
    if done.returncode != 0:
        lines = "\n".join((done.stderr or done.stdout).strip().splitlines()[:20])
        raise BridgeError(f"IDL that cannot be compiled: {lines}", FailureReason.BAD_ENDPOINT)
