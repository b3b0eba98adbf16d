"""Walking message structures by field path."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from attrs import frozen

from uoarm._adapt._mapping import Path, write_path
from uoarm._meaning import INHERITED
from uoarm.model import MessageStructure

__all__ = ["Field", "Structure", "UnfitError", "leaves", "number_problem"]

_MAX_LEAVES = 500
_MAX_DEPTH = 12


class UnfitError(Exception):
    """A mapping does not fit a structure; the text says where."""

    def __init__(self, path: str, sentence: str) -> None:
        super().__init__(sentence)
        self.path = path


@frozen
class Field:
    """The schema at a path, and whether every message has it."""

    schema: Any
    always: bool


class Structure:
    """A schema that is walked; references to its own `$defs` are followed.

    Args:
        schema: JSON Schema.
        definitions: the `$defs` that references mean; the schema's own when None.
    """

    def __init__(self, schema: Any, definitions: Mapping[str, Any] | None = None) -> None:
        self.schema = schema
        own = schema.get("$defs", {}) if isinstance(schema, Mapping) else {}
        self.definitions: Mapping[str, Any] = own if definitions is None else definitions

    def plain(self, schema: Any, path: str) -> Mapping[str, Any]:
        """Return a schema with references followed.

        Raises:
            UnfitError: it is `true`, `false`, or refers to something else than `$defs`.
        """
        for _ in range(32):
            if not isinstance(schema, Mapping):
                raise UnfitError(path, "the structure says nothing of this field")
            if "$ref" not in schema:
                return schema
            name = str(schema["$ref"]).removeprefix("#/$defs/")
            if name not in self.definitions:
                raise UnfitError(path, f"the reference {schema['$ref']!r} cannot be followed here")
            schema = self.definitions[name]
        raise UnfitError(path, "the references go in a circle")

    def at(self, path: Path) -> Field:
        """Return the field at a path, with what the objects around it say of its meaning.

        Raises:
            UnfitError: there is no such field, or a choice stands in the way.
        """
        schema, always = self.schema, True
        said: dict[str, Any] = {}
        for number, part in enumerate(path):
            where = write_path(path[: number + 1])
            one = self.plain(schema, where)
            fields = one.get("properties", {})
            if part not in fields:
                has = ", ".join(fields) or "none"
                raise UnfitError(where, f"there is no field {part!r}; there is {has}")
            if any(key in one for key in ("anyOf", "oneOf", "allOf", "if")):
                raise UnfitError(where, "a choice of structures stands in the way")
            always = always and part in one.get("required", ())
            said |= {key: one[key] for key in INHERITED if key in one}
            schema = fields[part]
        return Field({**said, **schema} if said and schema is not True else schema, always)

    def fields(self) -> Mapping[str, Any]:
        """Return the named fields of the whole message, none for what is no object."""
        try:
            fields: Mapping[str, Any] = self.plain(self.schema, ".").get("properties", {})
        except UnfitError:
            return {}
        return fields


def leaves(structure: Structure) -> Iterator[tuple[Path, Any]]:
    """Yield every field path of a structure with its schema, outer before inner, bounded."""
    waiting: list[tuple[Path, Any]] = [((), structure.schema)]
    count = 0
    for path, schema in waiting:
        try:
            plain = structure.plain(schema, write_path(path))
        except UnfitError:
            continue
        for name, child in plain.get("properties", {}).items():
            count += 1
            if count > _MAX_LEAVES:
                return
            yield (*path, name), child
            if len(path) < _MAX_DEPTH:
                waiting.append(((*path, name), child))


def number_problem(structure: MessageStructure, path: str) -> str:
    """Return why the field at a path is no number in every message; nothing where it is one."""
    try:
        walked = Structure(structure.schema)
        parts = () if path == "." else tuple(path.split("."))
        found = walked.at(parts)
        kind = walked.plain(found.schema, path).get("type")
    except UnfitError as error:
        return f"{error.path}: {error}"
    if kind not in ("number", "integer"):
        return f"{path} is no number"
    return "" if found.always else f"{path} may be missing"
