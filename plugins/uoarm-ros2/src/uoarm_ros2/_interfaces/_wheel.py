"""A wheel as a file: the archive and its record, as the format's specification has them."""

from __future__ import annotations

import base64
import hashlib
import sys
import sysconfig
import zipfile
from collections.abc import Mapping
from pathlib import Path

__all__ = ["write_wheel"]


def write_wheel(
    output: Path, name: str, version: str, requires: tuple[str, ...], files: Mapping[str, Path]
) -> Path:
    """Write a wheel for this interpreter and platform; returns its path.

    Args:
        output: the folder that it goes to.
        name: of the distribution, with underscores.
        version: of the distribution.
        requires: what pip is to have installed beside.
        files: what it holds, by the name in the wheel; those below `data/` go below the prefix.
    """
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    abi = python + getattr(sys, "abiflags", "")
    platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
    tag = f"{python}-{abi}-{platform}"
    stem = f"{name}-{version}"
    metadata = ["Metadata-Version: 2.1", f"Name: {name.replace('_', '-')}", f"Version: {version}"]
    metadata += [f"Requires-Dist: {text}" for text in requires]
    wheel = ["Wheel-Version: 1.0", "Generator: uoarm", "Root-Is-Purelib: false", f"Tag: {tag}"]
    contents = {
        (f"{stem}.{text}" if text.startswith("data/") else text): path.read_bytes()
        for text, path in sorted(files.items())
    }
    contents[f"{stem}.dist-info/METADATA"] = _text(metadata)
    contents[f"{stem}.dist-info/WHEEL"] = _text(wheel)
    record = f"{stem}.dist-info/RECORD"
    rows = [f"{key},sha256={_hash(octets)},{len(octets)}" for key, octets in contents.items()]
    contents[record] = _text([*rows, f"{record},,"])
    path = output / f"{stem}-{tag}.whl"
    part = path.with_suffix(".part")
    try:
        with zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED) as archive:
            for key, octets in contents.items():
                archive.writestr(key, octets)
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
    return path


def _text(lines: list[str]) -> bytes:
    return ("\n".join(lines) + "\n").encode()


def _hash(octets: bytes) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(octets).digest()).rstrip(b"=").decode()
