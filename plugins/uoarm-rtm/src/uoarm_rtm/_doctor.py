"""Facts about the installed CORBA, for `uoarm doctor`."""

from __future__ import annotations

import os
import shutil

import omniORB

from uoarm_rtm._compiler import omniorb_programs

__all__ = ["environment"]


def environment() -> dict[str, str]:
    """Return the version of omniORB, where its programs are, and variables of the environment."""
    programs = omniorb_programs()
    naming = (programs / "omniNames") if programs is not None else shutil.which("omniNames")
    facts = {
        "omniORBpy": str(omniORB.coreVersion()),
        "omniNames": str(naming or "missing"),
    }
    for name in ("OMNIORB_CONFIG", "ORBendPoint"):
        if name in os.environ:
            facts[name] = os.environ[name]
    return facts
