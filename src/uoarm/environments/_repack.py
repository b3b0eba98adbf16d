"""The wheel of an installed distribution, made anew from its own files.

An environment must run the very uoarm that this process runs. What that was installed from may be
gone, may have changed since, or may be known to no index: its files are here for certain.
"""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import zipfile
from importlib.metadata import Distribution
from pathlib import Path, PurePosixPath

__all__ = ["repack"]

# Written by what installs a wheel, not part of one.
_LEFT_OUT = frozenset({"RECORD", "INSTALLER", "REQUESTED", "direct_url.json"})


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
