"""Mistakes of shape, by the published JSON Schema, and options that uoarm fills in.

An option of a plugin may carry `x-uoarm-assign` in the plugin's options schema:

    "domain_id": {"type": "integer", "x-uoarm-assign": {"from": 64, "to": 101}}

Bridges of one plugin that run with several installations of it, each in hosts of its own, then
get a number each, the same in every run: those whose configuration names none, one for each
installation, in the order of the file, from the first of the range that is free.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Hashable, Iterator, Mapping
from copy import deepcopy
from functools import cache
from importlib.resources import files
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from attrs import evolve, frozen

from uoarm._meaning import unit_mistake
from uoarm._mistakes import (
    TYPES,
    Mistake,
    any_of,
    certainly_matches,
    is_about_a_key,
    mistakes,
    near,
)
from uoarm._spelling import Speller
from uoarm._support.yaml import Document, Path, Problem, clip, write_path
from uoarm.bridge import BridgeType
from uoarm.errors import ConfigurationError
from uoarm.model import BridgeSpec, Options, Robot
from uoarm.schema import portable

if TYPE_CHECKING:
    from jsonschema.exceptions import ValidationError
    from jsonschema.protocols import Validator


_DIALECT = "https://json-schema.org/draft/2020-12/"
_RULE_KINDS = ("from", "const", "each")
_FREE_KEYS = {
    "bridges": "names of bridges", "functions": "names of functions",
    "inputs": "names of inputs; one alone is `input`",
    "outputs": "names of outputs; one alone is `output`",
    "limits": "paths of numbers, such as linear.x", "offer": "names of bridges",
}  # fmt: skip
_PORT_PARTS = (
    "input", "output", "service", "offered_output", "offered_input", "offered_service",
)  # fmt: skip
_NAME_HINT = "a name has letters, digits, _ and -, begins with a letter or _, 128 at most"


@cache
def published_schema() -> dict[str, Any]:
    """Return the JSON Schema of the configuration file, for editors and for this check."""
    return _read_schema("robot.schema.json")


def completed_schema(types: Mapping[str, BridgeType]) -> dict[str, Any]:
    """Return the published schema with the options of these plugins, for editors.

    The options of a bridge are those of its plugin. Which bridge a port belongs to no JSON Schema
    can say: its options are explained for all plugins, and none is refused here. `check` does.
    """
    schema: dict[str, Any] = deepcopy(published_schema())
    definitions, named = schema["$defs"], {}
    cases = definitions["bridge"].setdefault("allOf", [])
    for name, kind in types.items():
        inner, hoisted = portable(kind.options_schema, f"options.{name}", whole=True)
        definitions |= {f"options.{name}": inner, **hoisted.get("$defs", {})}
        options = {"properties": {"options": {"$ref": f"#/$defs/options.{name}"}}}
        is_it = {"properties": {"plugin": {"const": name}}, "required": ["plugin"]}
        cases.append({"if": is_it, "then": options})
        unnamed = {"if": {"not": {"required": ["plugin"]}}, "then": options}
        named[name] = {"allOf": [{"$ref": "#/$defs/bridge"}, unnamed]}
    schema["properties"]["bridges"]["properties"] = named
    for part in _PORT_PARTS:
        definitions[part]["properties"]["options"]["properties"] = _options_of_ports(types)
    return schema


def _options_of_ports(types: Mapping[str, BridgeType]) -> dict[str, Any]:
    found: dict[str, list[dict[str, Any]]] = {}
    for name, kind in types.items():
        schema: Any = {} if kind.endpoint_options is None else kind.endpoint_options.schema()
        for key, known in schema.get("properties", {}).items():
            described = {**known, "description": f"{name}: {known['description']}"}
            found.setdefault(key, []).append(described)
    return {
        key: forms[0]
        if len(forms) == 1
        else {"anyOf": forms, "description": "\n".join(form["description"] for form in forms)}
        for key, forms in found.items()
    }


@cache
def structure_schema() -> dict[str, Any]:
    """Return the JSON Schema of message structures: the dialect, and what values mean."""
    return _read_schema("structure.schema.json")


def _read_schema(file: str) -> dict[str, Any]:
    text = files("uoarm.config").joinpath(file).read_text(encoding="utf-8")
    schema: dict[str, Any] = json.loads(text)
    return schema


class ShapeChecker:
    """Holds a document against the published schema, and its structures against JSON Schema."""

    def __init__(self, document: Document, file: str, speller: Speller) -> None:
        self._document = document
        self._file = file
        self._speller = speller
        self._metaschema: Validator | None = None
        self._sound: set[str] = set()

    def problems(self) -> Iterator[Problem]:
        """Yield every mistake of shape in the document."""
        value: Any = self._document.value
        if certainly_matches(value, published_schema()):
            return
        for error in _validator(published_schema(), {"$ref": _local}).iter_errors(value):
            yield from map(self._problem, _mistakes(error, self._speller))

    def structure_problems(self, structure: Any, path: Path) -> Iterator[Problem]:
        """Yield what keeps a declared structure from being a JSON Schema."""
        text = json.dumps(structure, sort_keys=True)
        if text in self._sound:
            return
        try:
            found = list(self._meta().iter_errors(structure))
        except RecursionError:
            yield self._problem((path, "this structure is nested too deeply", "", False))
            return
        if not found:
            units = list(_unit_mistakes(structure, path))
            if not units:
                self._sound.add(text)
            yield from map(self._problem, units)
        for error in found:
            for where, sentence, hint, at_key in _mistakes(error, self._speller):
                message = f"not a JSON Schema: {sentence}"
                yield self._problem(((*path, *where), message, hint, at_key))

    def _meta(self) -> Validator:
        if self._metaschema is None:
            self._metaschema = _validator(structure_schema())
        return self._metaschema

    def _problem(self, mistake: Mistake) -> Problem:
        path, sentence, hint, at_key = mistake
        place = self._document.key_place(path) if at_key else self._document.place(path)
        return Problem(
            place=place, path=write_path(path), sentence=sentence, hint=hint, file=self._file
        )


def _unit_mistakes(structure: Any, path: Path) -> Iterator[Mistake]:
    """Yield the units that are none, wherever in a structure that is sound otherwise."""
    waiting: list[tuple[Any, Path]] = [(structure, path)]
    for value, where in waiting:
        if isinstance(value, dict):
            unit = value.get("x-unit")
            text = unit_mistake(unit) if isinstance(unit, str) else ""
            if text:
                yield (*where, "x-unit"), text, "", False
            waiting.extend((item, (*where, name)) for name, item in value.items())
        elif isinstance(value, list):
            waiting.extend((item, (*where, number)) for number, item in enumerate(value))


def _validator(
    schema: Mapping[str, Any], keywords: Mapping[str, Callable[..., Any]] = MappingProxyType({})
) -> Validator:
    """Return a validator whose `uniqueItems` costs no more than its list is long.

    With `keywords`, these are held by functions of their own, too.
    """
    from jsonschema import Draft202012Validator  # noqa: PLC0415 - slow import
    from jsonschema.validators import extend  # noqa: PLC0415 - as above
    from jsonschema_specifications import (  # type: ignore[import-untyped]  # noqa: PLC0415
        REGISTRY,
    )
    from referencing import Registry  # noqa: PLC0415 - as above
    from referencing.jsonschema import DRAFT202012  # noqa: PLC0415 - as above

    # Where a schema names its dialect, jsonschema takes that one's own validator for it.
    plain: Registry[Any] = Registry().with_resources(
        (uri, DRAFT202012.create_resource(_without_dialect(REGISTRY.contents(uri))))
        for uri in REGISTRY
        if uri.startswith(_DIALECT)
    )
    kind: Any = extend(Draft202012Validator, {"uniqueItems": _twice, **keywords})  # type: ignore[no-untyped-call]
    made: Validator = kind(_without_dialect(schema), registry=plain)
    return made


def _without_dialect(schema: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in schema.items() if key != "$schema"}


def _local(validator: Validator, place: str, value: Any, schema: Any) -> Iterator[ValidationError]:
    """Hold a `$ref` to `$defs`, as all of the published schema are, without resolving a URI.

    That is a quarter of the time for a long file.
    """
    del schema
    name = place.removeprefix("#/$defs/")
    yield from validator.descend(value, published_schema()["$defs"][name])  # type: ignore[attr-defined]


def _twice(validator: Validator, unique: Any, value: Any, schema: Any) -> Iterator[ValidationError]:
    """Hold `uniqueItems` in time that grows with the list; jsonschema compares every pair."""
    from jsonschema import ValidationError  # noqa: PLC0415 - slow import

    del schema
    if unique and validator.is_type(value, "array") and len(set(map(_key, value))) < len(value):
        yield ValidationError("the same entry stands here twice")


def _key(value: object) -> Hashable:
    """Return what is equal where JSON values are; to Python, true is 1."""
    if isinstance(value, dict):
        return "mapping", frozenset((name, _key(item)) for name, item in value.items())
    if isinstance(value, list):
        return "list", tuple(map(_key, value))
    return isinstance(value, bool), value


def _mistakes(error: ValidationError, speller: Speller) -> Iterator[Mistake]:
    """Yield the mistakes behind one error; names and the forms of a rule are ours to explain."""
    path: Path = tuple(error.absolute_path)
    value: Any = error.instance
    keyword = str(error.validator)
    rules: Any = error.schema
    if is_about_a_key(error):
        yield (*path, value), f"the name {clip(value)} is not allowed", _NAME_HINT, True
    elif keyword in {"pattern", "maxLength"} and {"pattern", "maxLength"} <= rules.keys():
        yield path, f"the name {clip(value)} is not allowed", _NAME_HINT, False
    elif keyword == "anyOf":
        yield from _no_branch_fits(error, rules.get("x-kinds"), speller)
    elif keyword == "type" and "additionalProperties" in [*error.absolute_schema_path][-3:]:
        # An entry of a mapping whose keys are free: often its level was left out.
        keys = _FREE_KEYS.get(str(path[-2]) if len(path) > 1 else "")
        hint = f"the keys of {path[-2]} are {keys}" if keys else ""
        yield from (
            (*mistake[:2], mistake[2] or hint, mistake[3]) for mistake in mistakes(error, speller)
        )
    else:
        yield from mistakes(error, speller)


def _no_branch_fits(
    error: ValidationError, kinds: list[str] | None, speller: Speller
) -> Iterator[Mistake]:
    path: Path = tuple(error.absolute_path)
    value: Any = error.instance
    if kinds is None:
        yield _simple_choice(path, value, speller)
        return
    if not isinstance(value, dict):
        sentence = f"expected a path in the source, or from, const or each; got {clip(value)}"
        yield path, sentence, "", False
        return
    present = [kind for kind in _RULE_KINDS if kind in value]
    if len(present) != 1:
        got = clip(list(value)) if value else "an empty mapping"
        sentence = f"expected exactly one of from, const and each, got {got}"
        yield path, sentence, "", False
        return
    branch = kinds.index(present[0])
    for inner in error.context or ():
        if inner.relative_schema_path[0] == branch:
            yield from _mistakes(inner, speller)


def _simple_choice(path: Path, value: Any, speller: Speller) -> Mistake:
    """The metaschema's one choice: the name of a type, or a list of such names."""
    wrong = value
    if isinstance(value, list):
        wrong = next((item for item in value if item not in [*TYPES]), value)
    sentence = f"expected {any_of(TYPES)}, got {clip(wrong)}"
    return path, sentence, near(wrong, TYPES, speller), False


ASSIGN = "x-uoarm-assign"
OF_A_HOST = ("environment", "python")


@frozen
class Assignable:
    """An option whose value uoarm may choose.

    Attributes:
        option: its name.
        numbers: what it may be.
        variable: an environment variable whose value is taken and is not given out.
    """

    option: str
    numbers: range
    variable: str = ""

    def free(self, taken: set[object]) -> int | None:
        """Return the first number that is free."""
        theirs = os.environ.get(self.variable, "") if self.variable else ""
        return next(
            (number for number in self.numbers if number not in taken and str(number) != theirs),
            None,
        )


def assignables(kind: BridgeType) -> Iterator[Assignable]:
    """Yield the options of a plugin that uoarm may choose."""
    schema: Any = kind.options_schema
    properties = schema.get("properties", {}) if isinstance(schema, Mapping) else {}
    for name, option in properties.items():
        wish = option.get(ASSIGN) if isinstance(option, Mapping) else None
        if wish is not None:
            numbers = range(int(wish["from"]), int(wish["to"]) + 1)
            yield Assignable(name, numbers, str(wish.get("except_variable", "")))


def installation(host: object) -> str:
    """Name the installation that a bridge runs with, from its `host:`; empty: our own."""
    if not isinstance(host, Mapping):
        return ""
    return " ".join(f"{name} {host[name]}" for name in OF_A_HOST if host.get(name))


def assign(robot: Robot, types: Mapping[str, BridgeType]) -> Robot:
    """Return the robot with the options of its bridges filled in; see `BridgeSpec.assigned`.

    Raises:
        ConfigurationError: a range has fewer numbers than there are installations.
    """
    bridges = dict(robot.bridges)
    for plugin in dict.fromkeys(spec.plugin for spec in robot.bridges.values()):
        specs = [spec for spec in robot.bridges.values() if spec.plugin == plugin]
        several = len({installation(spec.host) for spec in specs}) > 1
        if several and (kind := types.get(plugin)) is not None:
            for assignable in assignables(kind):
                bridges |= {spec.name: spec for spec in _assigned(assignable, specs, bridges)}
    return evolve(robot, bridges=bridges)


def _assigned(
    assignable: Assignable, specs: list[BridgeSpec], bridges: Mapping[str, BridgeSpec]
) -> Iterator[BridgeSpec]:
    """Yield the bridges that get a number; others keep their default: in our process, elsewhere."""
    taken: set[object] = {spec.options.get(assignable.option) for spec in specs}
    chosen: dict[str, int] = {}
    for spec in specs:
        if spec.host is None or "machine" in spec.host or assignable.option in spec.options:
            continue
        place = installation(spec.host)
        if place not in chosen:
            number = assignable.free(taken)
            if number is None:
                raise ConfigurationError(
                    f"bridge {spec.name!r}: no {assignable.option} is left between "
                    f"{assignable.numbers[0]} and {assignable.numbers[-1]}; "
                    "write one under `options`"
                )
            chosen[place] = number
            taken.add(number)
        yield _with(bridges[spec.name], {assignable.option: chosen[place]})


def _with(spec: BridgeSpec, chosen: Options) -> BridgeSpec:
    return evolve(spec, options={**spec.options, **chosen}, assigned={**spec.assigned, **chosen})
