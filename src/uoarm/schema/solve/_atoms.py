"""The demands of a schema's own keywords, and the ways to fail them, for each JSON kind."""

from __future__ import annotations

from uoarm.schema.read import Node
from uoarm.schema.solve._branch import Atom

__all__ = ["ATOMS", "VIOLATIONS"]


def _number_atoms(node: Node) -> list[Atom]:
    atoms: list[Atom] = []
    if node.integer_only:
        atoms.append(("multiple", 1))
    if node.minimum is not None:
        atoms.append(("low", node.minimum, False))
    if node.above is not None:
        atoms.append(("low", node.above, True))
    if node.maximum is not None:
        atoms.append(("high", node.maximum, False))
    if node.below is not None:
        atoms.append(("high", node.below, True))
    if node.multiple is not None:
        atoms.append(("multiple", node.multiple))
    return atoms


_OPPOSITE = {"low": "high", "high": "low", "multiple": "notmultiple"}


def _number_violations(node: Node) -> list[Atom]:
    return [
        (_OPPOSITE[str(tag)], rest[0], not rest[1]) if len(rest) > 1 else ("notmultiple", rest[0])
        for tag, *rest in _number_atoms(node)
    ]


def _string_atoms(node: Node) -> list[Atom]:
    atoms = _sizes(node.min_length, node.max_length)
    return atoms if node.pattern is None else [*atoms, ("match", node.pattern)]


def _string_violations(node: Node) -> list[Atom]:
    atoms = _sizes_violated(node.min_length, node.max_length)
    return atoms if node.pattern is None else [*atoms, ("nomatch", node.pattern)]


def _array_atoms(node: Node) -> list[Atom]:
    atoms = _sizes(node.min_items, node.max_items)
    atoms.extend(("at", n, (subschema, True)) for n, subschema in enumerate(node.prefix))
    if node.items is not None:
        atoms.append(("tail", len(node.prefix), (node.items, True)))
    if node.contains is not None:
        atoms.append(("contains", node.contains, node.min_contains, node.max_contains))
    if node.unique:
        atoms.append(("unique",))
    return atoms


def _array_violations(node: Node) -> list[Atom]:
    atoms = _sizes_violated(node.min_items, node.max_items)
    atoms.extend(("someat", n, (subschema, False)) for n, subschema in enumerate(node.prefix))
    if node.items is not None:
        atoms.append(("some", len(node.prefix), (node.items, False)))
    if node.contains is not None:
        if node.min_contains > 0:
            atoms.append(("contains", node.contains, 0, node.min_contains - 1))
        if node.max_contains is not None:
            atoms.append(("contains", node.contains, node.max_contains + 1, None))
    if node.unique:
        atoms.append(("twice",))
    return atoms


def _object_atoms(node: Node) -> list[Atom]:
    atoms = _sizes(node.min_properties, node.max_properties)
    atoms.extend(("has", name) for name in node.required)
    atoms.extend(("member", name, (property_, True)) for name, property_ in node.properties.items())
    atoms.extend(("pattern", pattern, (subschema, True)) for pattern, subschema in node.patterns)
    if node.additional is not None:
        atoms.append(("rest", node, (node.additional, True)))
    if node.names is not None:
        atoms.append(("names", (node.names, True)))
    return atoms


def _object_violations(node: Node) -> list[Atom]:
    atoms: list[Atom] = [("lacks", name) for name in node.required]
    atoms.extend(
        ("somemember", name, (property_, False)) for name, property_ in node.properties.items()
    )
    atoms.extend(
        ("somepattern", pattern, (subschema, False)) for pattern, subschema in node.patterns
    )
    if node.additional is not None:
        atoms.append(("somerest", node, (node.additional, False)))
    if node.names is not None:
        atoms.append(("somename", (node.names, False)))
    return atoms + _sizes_violated(node.min_properties, node.max_properties)


def _sizes(least: int, most: int | None) -> list[Atom]:
    atoms: list[Atom] = [("least", least)] if least else []
    return atoms if most is None else [*atoms, ("most", most)]


def _sizes_violated(least: int, most: int | None) -> list[Atom]:
    atoms: list[Atom] = [("most", least - 1)] if least else []
    return atoms if most is None else [*atoms, ("least", most + 1)]


def _nothing(node: Node) -> list[Atom]:
    del node
    return []


ATOMS = {
    "null": _nothing,
    "boolean": _nothing,
    "number": _number_atoms,
    "string": _string_atoms,
    "array": _array_atoms,
    "object": _object_atoms,
}
VIOLATIONS = {
    "null": _nothing,
    "boolean": _nothing,
    "number": _number_violations,
    "string": _string_violations,
    "array": _array_violations,
    "object": _object_violations,
}
