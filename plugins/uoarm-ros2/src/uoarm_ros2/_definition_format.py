"""ROS definitions as a format that uoarm compares locks with."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from uoarm.plugins import DefinitionFormat, Definitions, hookimpl
from uoarm_ros2.definitions import read_definitions, types_of

_SUFFIXES = frozenset({".msg", ".srv", ".action", ".idl"})


@hookimpl
def uoarm_definition_formats() -> list[DefinitionFormat]:
    """Return the one format of this plugin."""
    return [DefinitionFormat("definitions of ROS", _SUFFIXES, _read, contract=1)]


def _read(folder: Path) -> Definitions:
    found = read_definitions(folder)
    schemas = {
        name: structure.schema
        for name, structure in found.structures.items()
        if isinstance(structure.schema, Mapping)  # of a type that was read it is, always
    }
    problems = dict(found.problems)
    for file in [problem for problem in problems if Path(problem).suffix in _SUFFIXES]:
        text = f"{file}: {problems.pop(file)}"
        problems |= dict.fromkeys(types_of(Path(file)), text)
    return Definitions(schemas, problems)
