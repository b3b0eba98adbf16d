# ruff: noqa: INP001 - a script beside the package
"""Write `src/uoarm_rtm/_stubs` anew from `src/uoarm_rtm/idl`."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
STUBS = HERE / "src" / "uoarm_rtm" / "_stubs"


def regenerate(into: Path) -> None:
    """Compile every IDL file of the plugin into the package folder `into`."""
    from uoarm_rtm._compiler import OUR_IDL, compile_idl  # noqa: PLC0415 - installed or beside us

    files = sorted(path.name for path in OUR_IDL.glob("*.idl"))
    with tempfile.TemporaryDirectory() as folder:
        compile_idl(files, Path(folder), package="uoarm_rtm._stubs", directory=OUR_IDL)
        shutil.rmtree(into, ignore_errors=True)
        shutil.copytree(Path(folder) / "uoarm_rtm" / "_stubs", into)


if __name__ == "__main__":
    sys.path.insert(0, str(HERE / "src"))
    regenerate(STUBS)
