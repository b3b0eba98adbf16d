"""A schema of an older draft as one of the newest, for those who read no other.

What keywords are called in older drafts is known to `read/_resources.py`; here a whole schema is
written anew, so that references lead to the parts that they led to.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias
from urllib.parse import unquote

from attrs import frozen

from uoarm.schema._errors import SchemaError
from uoarm.schema._parts import LISTS, MAPS, SINGLES, at_step
from uoarm.schema.read import NEWEST, REFERENCES, Dialect, dialect_of

_Steps: TypeAlias = "tuple[str | int, ...]"

_BY_NAME = frozenset({*MAPS, "definitions"})
_OF_DRAFT = frozenset({"$schema", "$recursiveAnchor"})
_NAMING = frozenset({"$id", "$anchor"})


def newest(schema: Any) -> Any:
    """Return a JSON Schema of draft 2020-12 that accepts what this one accepts.

    Drafts 04, 06, 07 and 2019-09 are read where `$schema` names them. A schema of 2020-12 is
    returned as it is, as is one that names no draft and has no older form, such as `items` as a
    list. What is malformed otherwise stays so.

    Raises:
        SchemaError: it names a draft that is not known, or is not to be written in the newest one.

    Example:
        >>> newest({"items": [{"type": "null"}], "additionalItems": False})
        {'prefixItems': [{'type': 'null'}], 'items': False}
    """
    if not isinstance(schema, Mapping):
        return schema
    dialect = dialect_of(schema)
    if dialect is None:
        raise SchemaError("#/$schema", "draft 04, 06, 07, 2019-09 or 2020-12", schema["$schema"])
    try:
        return _Rewriting(schema, dialect).made()
    except RecursionError:
        text = "a schema that is nested less deeply"
        raise SchemaError("", text, f"one of draft {dialect.uri}") from None


@frozen
class _Place:
    """Where a part is: in the schema as it was written, and in what is made of it."""

    part: Mapping[str, Any]
    before: _Steps
    after: _Steps


class _Rewriting:
    """One schema, and where its parts are in what is made of it."""

    def __init__(self, schema: Mapping[str, Any], dialect: Dialect) -> None:
        self._whole = schema
        self._dialect = dialect
        self._places: dict[int, _Place] = {}
        self._refers = False
        address = dialect.view(schema).get("$id")
        self._address = address.removesuffix("#") if isinstance(address, str) else ""

    def made(self) -> Any:
        """Return the whole schema as it is in the newest draft."""
        self._find(self._whole, (), ())
        places = self._places.values()
        is_newest = self._dialect is NEWEST and all(
            NEWEST.view(at.part) is at.part and dialect_of(at.part) is NEWEST for at in places
        )
        if is_newest:
            return self._whole
        beside_contains = any("contains" in at.part for at in places)
        for at in places:
            objection = self._dialect.objection(at.part, beside_contains=beside_contains)
            if at.after and self._refers and "$id" in self._dialect.view(at.part):
                objection = "a schema with an address of its own stands within another one"
            if "$schema" in at.part and dialect_of(at.part) is not self._dialect:
                objection = "a schema of another draft stands within another one"
            if objection:
                text = "what can be written in draft 2020-12 too"
                raise SchemaError(_pointer(at.before), text, objection)
        return self._rewritten(self._whole)

    def _find(self, part: Any, before: _Steps, after: _Steps) -> None:
        if isinstance(part, Mapping) and id(part) not in self._places:
            self._places[id(part)] = _Place(part, before, after)
            view = self._dialect.view(part)
            self._refers = self._refers or not view.keys().isdisjoint(REFERENCES)
            for keyword, step, inner in _parts_of(view):
                said = self._dialect.spelled(part, keyword)
                self._find(inner, (*before, said, *step), (*after, keyword, *step))

    def _rewritten(self, part: Any) -> Any:
        if not isinstance(part, Mapping):
            return part
        view = self._dialect.view(part)
        left = _OF_DRAFT if self._refers else _OF_DRAFT | _NAMING
        # Tools write the pointer to a part as its name, to which a reference leads without it.
        if str(view.get("$anchor")).startswith("/"):
            left |= {"$anchor"}
        made = {keyword: value for keyword, value in view.items() if keyword not in left}
        for keyword, step, inner in _parts_of(view):
            if not step:
                made[keyword] = self._rewritten(inner)
                continue
            if made[keyword] is view[keyword]:
                made[keyword] = view[keyword].copy()
            made[keyword][step[0]] = self._rewritten(inner)
        for keyword in ("$ref", "$recursiveRef"):
            if isinstance(made.get(keyword), str):
                target = self._target(part, made.pop(keyword))
                # A place is not known of true and false, and no place may be said twice.
                if isinstance(target, str) and "$ref" not in made:
                    made["$ref"] = target
                else:
                    more = {"$ref": target} if isinstance(target, str) else target
                    made["allOf"] = [*made.get("allOf", ()), more]
        return made

    def _target(self, part: Mapping[str, Any], reference: str) -> str | bool:
        """Return what a reference of a part is now; true or false where it led to that."""
        address, _, fragment = reference.partition("#")
        # By a name, or to what is not here, it leads where it did.
        if address not in {"", self._address} or (fragment and not fragment.startswith("/")):
            return reference
        found: Any = self._whole
        for step in unquote(fragment).split("/")[1:]:
            found = at_step(found, step)
        if isinstance(found, bool):
            return found
        if id(found) not in self._places:
            place = _pointer((*self._places[id(part)].before, "$ref"))
            raise SchemaError(place, "a reference to a part that is a schema", reference)
        return _pointer(self._places[id(found)].after)


def _parts_of(view: Mapping[str, Any]) -> Iterator[tuple[str, _Steps, Any]]:
    """Yield the schemas directly within one of the newest draft: keyword, place in it, schema."""
    for keyword, value in view.items():
        if keyword in SINGLES:
            yield keyword, (), value
        elif keyword in LISTS and isinstance(value, list):
            yield from ((keyword, (number,), part) for number, part in enumerate(value))
        elif keyword in _BY_NAME and isinstance(value, dict):
            yield from ((keyword, (name,), part) for name, part in value.items())


def _pointer(steps: _Steps) -> str:
    texts = (str(step).replace("~", "~0").replace("/", "~1") for step in steps)
    return "#" + "".join(f"/{text}" for text in texts)
