# ruff: noqa: INP001 - no package: omniidl finds the folder by its path
"""A back end for omniidl: the parameter names of every operation, which stubs do not keep.

omniidl imports it by its name (`-pFOLDER -buoarm_idl_names -Wbfile=PATH`) and calls `run`. It
writes JSON: repository id of the interface -> operation -> list of [parameter, direction].
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any


def run(tree: Any, arguments: list[str]) -> None:
    """Write the names of a parsed file; called by omniidl."""
    target = next(
        argument.removeprefix("file=") for argument in arguments if argument.startswith("file=")
    )
    found: dict[str, Any] = {}
    _visit(tree.declarations(), found)
    Path(target).write_text(json.dumps(found), encoding="utf-8")


def _visit(declarations: Any, found: dict[str, Any]) -> None:
    from omniidl import idlast  # noqa: PLC0415 - only inside the compiler's own process

    for declaration in declarations:
        if isinstance(declaration, idlast.Module):
            _visit(declaration.definitions(), found)
        elif isinstance(declaration, idlast.Interface):
            found[declaration.repoId()] = _operations(declaration)


def _operations(interface: Any) -> dict[str, list[list[str]]]:
    from omniidl import idlast  # noqa: PLC0415 - only inside the compiler's own process

    found: dict[str, list[list[str]]] = {}
    for parent in interface.inherits():
        found.update(_operations(parent))
    for callable_ in interface.callables():
        if isinstance(callable_, idlast.Attribute):
            for name in callable_.identifiers():
                found[f"_get_{name}"] = []
                if not callable_.readonly():
                    found[f"_set_{name}"] = [["value", "in"]]
        else:
            found[callable_.identifier()] = [
                [parameter.identifier(), parameter.dirtext()]
                for parameter in callable_.parameters()
            ]
    return found
