"""Handlers get and give what their hints say: objects, arrays, numbers of numpy."""

from __future__ import annotations

import builtins
import importlib
import sys
import typing
from array import array
from dataclasses import dataclass, field, make_dataclass
from enum import Enum, IntEnum, IntFlag
from functools import reduce
from types import ModuleType, SimpleNamespace
from typing import Annotated, Any, ClassVar, Final, Literal, NewType, get_origin

import attrs
import numpy as np
import pytest
from hypothesis import given, reject
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.local import quoted_parts, talk, typed_parts
from tests.processes import run_python
from typing_extensions import NotRequired, ReadOnly, Required, TypedDict

from uoarm import RobotManager
from uoarm._dataplane import make_check
from uoarm._hints.applications import as_message
from uoarm._hints.convert import plain, reader, writer
from uoarm._hints.schemas import is_plain, is_record
from uoarm.config import loads
from uoarm.errors import BridgeError, FailureReason, MessageError
from uoarm.local import HintError, Range, Shape, schema_of
from uoarm.model import MessageStructure, Role, ValidationMode
from uoarm.schema import check
from uoarm.testing import patience, same

SCAN = typed_parts.scan_of()
_with_late_hints = pytest.mark.skipif(
    sys.version_info < (3, 14), reason="before CPython 3.14 such a module is not imported"
)


class Named(TypedDict):
    name: str


@pytest.mark.parametrize("name", ["pass_scan", "ask_scan"])
def test_a_handler_gets_objects_in_objects_and_gives_plain_values(name: str) -> None:
    found = talk.through(name, SCAN)[0] if name == "pass_scan" else talk.call(name, SCAN)
    assert same(found, SCAN)
    assert type(found["header"]["mode"]) is str


def test_a_typed_dict_of_objects_is_made_of_objects() -> None:
    box = {"scan": SCAN, "count": 1}
    assert same(talk.through("pass_box", box)[0], box)


def test_a_source_gives_objects() -> None:
    assert same(talk.given("scans")[0], SCAN)


@pytest.mark.parametrize(("name", "value"), [("doubled_twin", 4), ("tripled_twin", 6)])
def test_a_function_with_arguments_given_has_its_hints(name: str, value: int) -> None:
    assert talk.call(name, {"value": 2}) == {"value": value}
    assert talk.through(name, {"value": 2}) == [{"value": value}]


def test_a_source_with_arguments_given_has_its_hints() -> None:
    described = talk.describe("two_twins", Role.OUTPUT).message
    assert described is not None
    assert described == talk.describe("doubled_twin", Role.OUTPUT).message
    assert talk.given("two_twins") == [{"value": 0}, {"value": 1}]


def test_a_model_of_pydantic_is_built_and_given() -> None:
    pytest.importorskip("pydantic")
    name = "tests.local.model_parts:ask_order"
    assert talk.call(name, {"amount": 1, "mode": "slow"}) == {"amount": 2, "mode": "slow"}
    with pytest.raises(MessageError, match="greater than or equal to 0 @ amount"):
        talk.call(name, {"amount": -1, "mode": "slow"})
    described: Any = talk.describe(name, Role.SERVICE).request
    assert described.schema["required"] == ["amount", "mode"]
    assert described.schema["properties"]["amount"]["minimum"] == 0
    mode = described.schema["properties"]["mode"]  # which older ones of pydantic write otherwise
    assert check(mode, {"enum": ["fast", "slow"]}).compatible
    assert check({"enum": ["fast", "slow"]}, mode).compatible
    assert described.schema["additionalProperties"] is False


def test_structures_are_those_of_the_objects() -> None:
    structure = talk.describe("pass_scan", Role.INPUT).message
    assert structure is not None
    check = make_check(structure, ValidationMode.ALWAYS, "here")
    assert check is not None
    check(SCAN)
    for key, wrong in (("ranges", ["a"]), ("picture", [[1]]), ("points", [[1, 2]])):
        with pytest.raises(MessageError, match=key):
            check({**SCAN, key: wrong})
    schema: Any = structure.schema
    assert schema["properties"]["ranges"] == {"type": "array", "items": {"type": "number"}}
    assert schema["required"] == list(SCAN)


def test_a_list_of_no_rows_is_an_array_of_none() -> None:
    boxes = Annotated[NDArray[np.float32], Shape(None, None, 4)]
    read, write = reader(boxes, "here"), writer(boxes, "here")
    assert read is not None
    assert write is not None
    for make in (read, write):
        made: Any = [make([]), make([[], []]), make(np.zeros((0, 2, 4)))]
        assert [item.shape for item in made] == [(0, 0, 4), (2, 0, 4), (0, 2, 4)]
    with pytest.raises(MessageError, match=r"the shape \(1, 1, 0\)"):
        read([[[]]])


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"header": {"stamp": 1, "note": None}}, "'mode' is missing @ the message.header"),
        ({"points": [{"x": 1.0}]}, r"'y' is missing @ the message.points\[0\]"),
        ({"picture": [[1]]}, r"\(2, any\), got one of the shape .* @ the message.picture"),
        ({"picture": [1]}, r"got one of the shape \(1\), which a hint says as Shape\(1\)"),
        ({"header": {"stamp": 1, "mode": "fst", "note": None}}, "'fst' is not a valid Mode"),
    ],
)
def test_a_message_of_another_structure_is_refused_with_its_path(
    change: Any, expected: str
) -> None:
    with pytest.raises(MessageError, match=expected):
        talk.call("ask_scan", {**SCAN, **change})


@pytest.mark.parametrize("name", ["vague", "very_vague"])
def test_an_array_of_unknown_numbers_is_refused_with_what_to_write(name: str) -> None:
    with pytest.raises(HintError, match=r"write NDArray\[numpy.float32\].*Shape\(480, 640\)"):
        talk.describe(name, Role.INPUT)


def test_hints_of_numpy_have_structures() -> None:
    assert schema_of(np.int16) == {"type": "integer", "minimum": -(2**15), "maximum": 2**15 - 1}
    assert schema_of(NDArray[np.uint8])["x-octets"] is True
    nested: Any = schema_of(np.ndarray[tuple[int, int], np.dtype[np.float64]])
    assert nested["items"] == {"type": "array", "items": {"type": "number"}}
    for hint in (np.floating, NDArray[np.complex64], np.ndarray):
        with pytest.raises(HintError, match="write NDArray"):
            schema_of(hint)


@dataclass
class Person:
    name: str


def test_what_is_noted_of_numbers_is_in_the_structure_of_their_arrays() -> None:
    metres = {"x-unit": "m"}
    reals = Annotated[NDArray[np.float32], metres, Range(0, 5)]
    number = {"type": "number", "minimum": 0, "maximum": 5}
    assert schema_of(reals) == {"type": "array", "items": number, **metres}
    grid: Any = schema_of(Annotated[NDArray[np.float32], metres, Shape(2, 3), Range(0, 5)])
    assert grid["items"] == {"type": "array", "items": number, "minItems": 3, "maxItems": 3}
    assert (grid["x-unit"], grid["maxItems"]) == ("m", 2)
    assert schema_of(Annotated[list[float], Range(0, 5)]) == {"type": "array", "items": number}
    either: Any = schema_of(Annotated[tuple[float, float] | None, Range(0, 5)])
    assert either["anyOf"][0]["prefixItems"] == [number, number]
    for hint in (Annotated[list[float], Shape(3)], Annotated[NDArray[np.float32] | None, Shape(3)]):
        with pytest.raises(HintError, match="Shape belongs to arrays of numpy"):
            schema_of(hint)


class Level(IntEnum):
    LOW = 1
    HIGH = 2


class Gear(str, Enum):
    FIRST = "first"


class Lamp(IntFlag):
    RED = 1
    GREEN = 2


class Sparse(IntFlag):
    ONE = 1
    FOUR = 4


@pytest.mark.parametrize("value", [Level.HIGH, Gear.FIRST, Lamp.RED | Lamp.GREEN, Lamp(0)])
def test_an_enumeration_of_numbers_or_texts_is_one(value: Any) -> None:
    kind = type(value)
    read, write = reader(kind, "here"), writer(kind, "here")
    assert read is not None
    assert write is not None
    assert type(write(value)) in {int, str}
    assert read(write(value)) is value
    check = make_check(MessageStructure(schema_of(kind)), ValidationMode.ALWAYS, "here")
    assert check is not None
    check(write(value))


@pytest.mark.parametrize("name", ["list", "dict", "tuple", "List", "Dict", "Tuple"])
def test_a_container_of_what_is_not_said_has_no_structure(name: str) -> None:
    with pytest.raises(HintError, match="has no message structure"):
        schema_of(getattr(typing, name, None) or getattr(builtins, name))
    assert schema_of(tuple[()])["minItems"] == 0


def test_a_generator_may_be_hinted_as_what_can_be_iterated() -> None:
    assert talk.given("iterable_counts", 2) == [0, 1]
    described = talk.describe("iterable_counts", Role.OUTPUT).message
    assert described is not None
    assert described.schema == {"type": "integer"}
    assert talk.describe("bare_counts", Role.OUTPUT).message is None


def test_a_literal_of_members_is_one_of_these() -> None:
    hint = list[Literal[Level.HIGH, "off"]]
    assert schema_of(hint)["items"] == {"enum": [2, "off"]}
    read, write = reader(hint, "here"), writer(hint, "here")
    assert read is not None
    assert write is not None
    assert read([2, "off"]) == [Level.HIGH, "off"]
    assert read([2])[0] is Level.HIGH
    assert type(write([Level.HIGH])[0]) is int


def test_flags_that_leave_out_bits_have_no_structure() -> None:
    with pytest.raises(HintError, match=r"Sparse.* leave out bits: write an int"):
        schema_of(Sparse)


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_octets_come_as_what_the_hint_says(kind: Any) -> None:
    assert schema_of(kind)["x-octets"] is True
    read = reader(kind, "here")
    assert read is not None
    for message in (b"ab", [97, 98]):
        assert type(read(message)) is kind
        assert bytes(read(message)) == b"ab"


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_octets_of_a_buffer_are_copied_and_not_listed(kind: Any) -> None:
    class Picture(np.ndarray):
        def tolist(self) -> Any:
            raise AssertionError("a list of a megabyte takes 60 ms")

    read = reader(kind, "here")
    assert read is not None
    assert bytes(read(np.array([1, 2], "u1").view(Picture))) == b"\1\2"


@pytest.mark.parametrize(
    "hint", [NDArray[np.float32], NDArray[np.int32], bytes, bytearray, memoryview]
)
@pytest.mark.parametrize(
    "message",
    [b"\1\2", bytearray(b"\1\2"), [1, 2], np.array([1, 2]), np.array([1, 2], ">i2"),
     array("i", [1, 2]), memoryview(array("H", [1, 2]))],
)  # fmt: skip
def test_numbers_stay_the_same_whatever_buffer_they_come_in(hint: Any, message: Any) -> None:
    read = reader(hint, "here")
    assert read is not None
    assert list(read(message)) == [1, 2]


ZERO = 0


@dataclass
class Given:
    text: str = ""
    byte: np.uint8 = ZERO  # type: ignore[assignment] # a number that it can hold
    real: np.float32 = ZERO  # type: ignore[assignment]
    reals: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, "f4"))
    several: list[Person] | Person | None = None


@pytest.mark.parametrize(
    "wrong",
    [{"text": 5}, {"text": b"x"}, {"text": None}, {"byte": 3.7}, {"byte": "5"}, {"byte": True},
     {"byte": 256}, {"byte": np.int64(2**40)}, {"real": "1"}, {"real": 1e300},
     {"reals": np.array([1e300])}, {"reals": np.ma.array([1], mask=True)}],
)  # fmt: skip
def test_what_a_hint_does_not_promise_is_given_to_none(wrong: Any) -> None:
    write = writer(Given, "here")
    assert write is not None
    with pytest.raises(BridgeError, match=next(iter(wrong))):
        write(Given(**wrong))
    given = write(
        Given(text=Gear.FIRST, byte=np.int64(255), real=np.float32(np.inf), several=[Person("n")])
    )
    assert given["reals"].dtype == "float32"
    assert {**given, "reals": None} == {
        "text": "first", "byte": 255, "real": np.inf, "reals": None, "several": [{"name": "n"}]
    }  # fmt: skip


class Count(TypedDict):
    number: int
    noted: Annotated[int, Range(0, 9)]
    data: bytes


def test_a_whole_number_may_be_written_as_a_float() -> None:
    read, write = reader(Count, "here"), writer(Count, "here")
    assert read is not None
    assert write is not None
    message = {"number": 1.0, "noted": 2.0, "data": b""}
    for count in (read(message), write(message)):
        assert count == {"number": 1, "noted": 2, "data": b""}
        assert [type(value) for value in count.values()] == [int, int, bytes]
    with pytest.raises(BridgeError, match="number"):
        write({**message, "number": 1.5})


class Counts(TypedDict):
    number: int
    real: float
    either: int | float
    maybe: NotRequired[int | None]
    inner: list[Annotated[int, Range(0, 9)]]
    named: dict[str, list[Plain | str]]


class Plain(TypedDict):
    number: int


@dataclass
class Held:
    counts: Counts
    several: list[int]
    maybe: int | None


COUNTS = {
    "number": 1.0,
    "real": 1.0,
    "either": 1.0,
    "maybe": 2.0,
    "inner": [1, 2.0],
    "named": {"one": [{"number": 3.0}, "n"], "none": []},
}
MADE = (
    "{'number': 1, 'real': 1.0, 'either': 1.0, 'maybe': 2, 'inner': [1, 2], "
    "'named': {'one': [{'number': 3}, 'n'], 'none': []}}"
)


@pytest.mark.parametrize(
    ("hint", "given", "expected"),
    [
        (int, 1.0, "1"),
        (int, 1.5, "1.5"),
        (int, float("inf"), "inf"),
        (float, 1.0, "1.0"),
        (NewType("Index", int), 1.0, "1"),
        (list[int], [1.0, 2], "[1, 2]"),
        (list[list[int]], [[1.0], []], "[[1], []]"),
        (list[int] | list[float], [1.0], "[1.0]"),
        (list[int] | int | None, 1.0, "1"),
        (tuple[int, ...], [1.0], "(1,)"),
        (dict[str, int], {"a": 1.0}, "{'a': 1}"),
        (
            Counts,
            COUNTS,
            MADE,
        ),
        (
            Held,
            {"counts": COUNTS, "several": [1.0], "maybe": 1.0},
            f"Held(counts={MADE}, several=[1], maybe=1)",
        ),
    ],
)
def test_a_handler_gets_an_int_where_its_hint_says_so(hint: Any, given: Any, expected: str) -> None:
    before, read = repr(given), reader(hint, "here")
    assert repr(given if read is None else read(given)) == expected
    assert repr(given) == before  # others get it, too


@pytest.mark.parametrize("name", ["Whole", "Defined", "Tuple", "Mapped"])
def test_what_hints_name_before_it_is_defined_is_converted_both_ways(name: str) -> None:
    kind = getattr(quoted_parts, name)
    read, write = reader(kind, "here"), writer(kind, "here")
    assert read is not None
    assert write is not None
    message = {"parts": [{"value": 1}], "spare": {"value": 2}}
    value = read(message)
    assert value == kind(parts=[quoted_parts.Part(1)], spare=quoted_parts.Part(2))
    assert write(value) == message
    with pytest.raises(MessageError, match=r"'value' is missing @ the message\.parts\[0\]\."):
        read({"parts": [{}], "spare": None})


def test_a_class_whose_hints_name_itself_is_converted_both_ways() -> None:
    read, write = reader(quoted_parts.Tree, "here"), writer(quoted_parts.Tree, "here")
    assert read is not None
    assert write is not None
    message = {"value": 1, "children": [{"value": 2, "children": []}]}
    value = read(message)
    assert value == quoted_parts.Tree(1, [quoted_parts.Tree(2, [])])
    assert write(value) == message


class Branch(TypedDict):
    number: int
    twigs: list[Branch]


def test_a_value_without_floats_and_one_of_a_hint_in_itself_are_passed() -> None:
    numbers = [1, 2, 3]
    read = reader(list[int], "here")
    assert read is not None
    assert read(numbers) is numbers
    read = reader(Branch, "here")
    assert read is not None
    assert read({"number": 1.0, "twigs": []}) == {"number": 1, "twigs": []}


def test_an_enumeration_of_what_is_no_json_has_no_structure() -> None:
    with pytest.raises(HintError, match="neither texts, numbers"):
        schema_of(Enum("Colour", {"RED": (255, 0, 0)}))


class Optionals(TypedDict, total=False):
    must: ReadOnly[Required[int]]
    noted: Annotated[Required[bytes], "x"]
    may: ReadOnly[bytes]


class Mostly(TypedDict):
    must: ReadOnly[int]
    may: Annotated[NotRequired[int], "x"]


def test_what_may_be_left_out_is_found_behind_other_qualifiers() -> None:
    assert schema_of(Optionals)["required"] == ["must", "noted"]
    assert schema_of(Mostly)["required"] == ["must"]


# Hints, a value of each, and its message.
LEAVES: list[tuple[Any, Any, Any]] = [
    (int, 3, 3), (str, "a", "a"), (bytes, b"ab", b"ab"), (Gear, Gear.FIRST, "first"),
    (Level, Level.HIGH, 2), (np.float32, np.float32(0.5), 0.5), (np.int8, np.int8(-3), -3),
    (Literal[Level.LOW, "z"], Level.LOW, 1), (bool | None, None, None),
]  # fmt: skip
HOW = st.sampled_from(
    [
        "list",
        "dict",
        "tuple",
        "pair",
        "new",
        "noted",
        "optional",
        "class",
        "attrs",
        "named",
        "typed",
    ]
)


HINTS: Any = SimpleNamespace(  # of what is only known as it runs
    list=list,
    dict=dict,
    tuple=tuple,
    Annotated=Annotated,
    Optional=typing.Optional,
    NamedTuple=typing.NamedTuple,
    NewType=NewType,
    ReadOnly=ReadOnly,
    TypedDict=TypedDict,
)


def _around(inner: tuple[Any, Any, Any], how: str) -> tuple[Any, Any, Any]:
    made: Any
    hint, value, message = inner
    words = {"x-unit": "m", "x-encoding": "z"}
    match how:
        case "list":
            return HINTS.list[hint], [value, value], [message, message]
        case "dict":
            return HINTS.dict[str, hint], {"k": value}, {"k": message}
        case "tuple":
            return HINTS.tuple[hint, ...], (value,), [message]
        case "pair":
            return HINTS.tuple[hint, int], (value, 1), [message, 1]
        case "new":
            return HINTS.NewType("New", hint), value, message
        case "noted":
            return HINTS.Annotated[hint, words], value, message
        case "optional" if get_origin(hint) is not Annotated:
            return HINTS.Optional[hint], value, message
        case "class":
            made = make_dataclass("Made", [("a", hint), ("b", Annotated[int, words])])
        case "attrs":
            made = attrs.make_class(
                "Made", {"a": attrs.field(type=hint), "b": attrs.field(type=int)}
            )
        case "named":
            made = HINTS.NamedTuple("Made", [("a", hint), ("b", int)])
        case _:
            fields = {"a": HINTS.ReadOnly[hint], "b": NotRequired[Annotated[int, words]]}
            return HINTS.TypedDict("Made", fields), {"a": value}, {"a": message}
    return made, made(a=value, b=1), {"a": message, "b": 1}


def _exact(value: Any) -> Any:
    """Return a value with the types in it, which numbers are equal without."""
    if isinstance(value, dict):
        return {name: _exact(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value), [_exact(item) for item in value]
    fields = getattr(value, "__dict__", None) if is_record(type(value)) else None
    return type(value), value if fields is None else _exact(fields)


@given(st.sampled_from(LEAVES), st.lists(HOW, max_size=4))
def test_values_become_the_messages_of_their_structure_and_come_back(
    leaf: tuple[Any, Any, Any], around: list[str]
) -> None:
    try:
        hint, value, message = reduce(_around, around, leaf)
    except TypeError:  # a union of what has no hash, which Python refuses
        reject()
    read, write = reader(hint, "here"), writer(hint, "here")
    made = value if write is None else write(value)
    assert same(made, message)
    check = make_check(MessageStructure(schema_of(hint)), ValidationMode.ALWAYS, "here")
    assert check is not None
    check(made)
    for form in (made, message):
        back = form if read is None else read(form)
        assert read is None or _exact(back) == _exact(value)


@pytest.mark.parametrize(
    ("hint", "expected"),
    [
        (Enum("Nothing", []), "Nothing.* has no members"),
        (Literal[b"a"], r"Literal\[b'a'\] has octets"),
    ],
)
def test_a_hint_of_which_no_message_can_be_is_refused_with_the_cause(
    hint: Any, expected: str
) -> None:
    with pytest.raises(HintError, match=expected):
        schema_of(hint)


def test_a_tuple_of_nothing_is_an_empty_list() -> None:
    read, write = reader(tuple[()], "here"), writer(tuple[()], "here")
    assert read is not None
    assert write is not None
    assert read([]) == ()
    assert list(write(())) == []
    assert check(schema_of(tuple[()]), {"const": []}).compatible


@pytest.mark.skipif(sys.version_info < (3, 11), reason="`*tuple` in a hint is of CPython 3.11")
def test_a_tuple_in_a_tuple_is_refused_with_what_to_write() -> None:
    with pytest.raises(HintError, match=r"tuple\[int, \*tuple.*: write a list"):
        schema_of(eval("tuple[int, *tuple[str, ...]]"))  # no syntax of 3.10


@dataclass
class Spot:
    x: Final[int]
    unit: ClassVar[str] = "mm"
    mode: Final[typed_parts.Mode] = typed_parts.Mode.FAST


@attrs.define
class Marked:
    spots: list[Spot]
    first: Final[NDArray[np.uint8]]
    limit: ClassVar[int] = 5


def test_what_is_of_the_class_is_no_field_and_what_is_final_is() -> None:
    read, write = reader(Marked, "here"), writer(Marked, "here")
    assert read is not None
    assert write is not None
    message = {"spots": [{"x": 1, "mode": "slow"}], "first": [1, 2]}
    made = read(message)
    assert made.spots == [Spot(1, typed_parts.Mode.SLOW)]
    assert same(write(made), message)
    assert check(schema_of(Spot), {"required": ["x", "mode"], "maxProperties": 2}).compatible
    made.spots[0] = Spot("a")  # type: ignore[arg-type] # that is the mistake
    with pytest.raises(BridgeError, match=r"gave something else than Marked: spots\.0\.x: "):
        write(made)


@dataclass
class Tree:
    value: int
    child: Tree | None


def test_a_class_within_itself_is_named() -> None:
    with pytest.raises(HintError, match=r"Tree.* is nested too deep or recursive"):
        schema_of(Tree)


def test_a_hint_that_cannot_be_converted_is_named_with_its_place() -> None:
    with pytest.raises(HintError, match=r"here: the type hint .*Tree.* cannot be converted"):
        reader(list[Tree] | dict[str, Tree], "here")


MEMBER = Literal[typed_parts.Mode.FAST]


@pytest.mark.parametrize(
    "hint", [MEMBER | int, list[MEMBER | int], MEMBER | typed_parts.Point | None]
)
def test_some_members_of_an_enumeration_are_no_choice_beside_others(hint: Any) -> None:
    with pytest.raises(HintError, match=r"here: .*write the enumeration in place of its Literal"):
        reader(hint, "here")


def test_some_members_of_an_enumeration_are_read_alone() -> None:
    read = reader(MEMBER | None, "here")
    assert read is not None
    assert read("fast") is typed_parts.Mode.FAST
    assert read(None) is None


@pytest.mark.parametrize("role", [Role.INPUT, Role.SERVICE])
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        # Two texts of cattrs, from 26.1 on and before.
        ("either", "(disambiguate between .*Count.*Twin|.*Twin'> has no usable)"),
        ("perhaps", "(disambiguate between .*Count.*Twin|.*Twin'> has no usable)"),
        # The second is of CPython 3.10, which cannot read the hints of such a class.
        ("seeded", "Seeded.* cannot be (built of its fields: missing .*'seed'|.*InitVar)"),
        ("takes_absent", ".*Holder.*: the type hints of its fields cannot be read: .*'Absent'"),
    ],
)
def test_what_no_message_could_become_is_refused_where_the_structure_is_made(
    name: str, role: Role, expected: str
) -> None:
    with pytest.raises(HintError, match=f"parts:{name}: .*{expected}") as caught:
        talk.describe(name, role)
    assert caught.value.reason is FailureReason.BAD_ENDPOINT


def test_a_parameter_that_no_value_could_become_is_refused_with_its_name() -> None:
    with pytest.raises(BridgeError, match=r"parameter 'seeds': .*cannot be (built of|.*InitVar)"):
        talk.describe("seed_within", Role.SERVICE, seeds=[{"value": 1}])


@pytest.mark.parametrize("role", [Role.INPUT, Role.SERVICE])
def test_hints_that_are_imported_for_a_type_checker_alone_are_refused(role: Role) -> None:
    expected = r"parts:absent: its type hints cannot be read: .*'Absent'.*not under TYPE_CHECKING"
    with pytest.raises(HintError, match=expected):
        talk.describe("absent", role)


@_with_late_hints
@pytest.mark.parametrize("name", ["takes", "Doubles"])
def test_hints_that_cannot_be_read_late_are_named_and_not_needed(name: str) -> None:
    where = f"tests.local.late_hints:{name}"
    with pytest.raises(HintError, match=r"its type hints cannot be read: .*'Absent'.*not under"):
        talk.describe(where, Role.SERVICE)
    if name == "Doubles":
        assert talk.call(where, 2) == 4  # as its structure is declared


@_with_late_hints
@pytest.mark.parametrize("name", ["Whole", "Defined"])
def test_what_late_hints_name_is_converted_both_ways(name: str) -> None:
    late = importlib.import_module("tests.local.late_hints")
    kind, message = getattr(late, name), {"part": {"value": 1}}
    read, write = reader(kind, "here"), writer(kind, "here")
    assert read is not None
    assert write is not None
    assert read(message) == kind(late.Part(1))
    assert write(kind(late.Part(1))) == message


def test_a_parameter_whose_hints_cannot_be_read_is_refused_with_its_name() -> None:
    with pytest.raises(BridgeError, match=r"parameter 'more': .*cannot be read: .*'Absent'"):
        talk.describe("given_absent", Role.SERVICE, more={"value": 1})


def test_objects_of_like_classes_may_be_given() -> None:
    assert talk.describe("gives_either", Role.OUTPUT).message is not None
    assert talk.given("gives_either", 2) == [{"value": 1}, {"value": 2}]


def test_numbers_of_numpy_are_numbers() -> None:
    for name in ("numpy_numbers", "numpy_reals"):
        structure = talk.describe(name, Role.OUTPUT).message
        assert structure is not None
        check = make_check(structure, ValidationMode.ALWAYS, name)
        assert check is not None
        check(talk.given(name)[0])
    counted = talk.given("numpy_count")[0]
    assert type(counted["value"]) is int


def test_text_and_octets_of_numpy_are_text_and_octets() -> None:
    labels = np.array(["cup", "hand"])
    message: Any = as_message({"label": labels[0], "more": [np.bytes_(b"a")]}, "here")
    assert message == {"label": "cup", "more": [b"a"]}
    assert [type(message["label"]), type(message["more"][0])] == [str, bytes]
    assert type(plain(labels[1])) is str


@pytest.mark.parametrize("value", [np.float32(0.5), np.array([1]), np.int64(300), np.bool_(True)])
def test_numbers_of_numpy_are_checked_as_others_are(value: Any) -> None:
    check = make_check(
        MessageStructure({"type": "integer", "maximum": 255}), ValidationMode.ALWAYS, "here"
    )
    assert check is not None
    check(np.uint8(255))
    with pytest.raises(MessageError):
        check(value)


def test_an_object_with_a_wrong_value_is_the_components_fault() -> None:
    with pytest.raises(
        BridgeError, match=r"typed_parts:wrong_reply gave .*: value: .* got 'nine'"
    ) as caught:
        talk.call("wrong_reply", {"value": 1})
    assert caught.value.reason is FailureReason.BAD_MESSAGE


def test_the_field_of_a_wrong_value_is_named() -> None:
    scan = {**SCAN, "points": [{"x": 1.0, "y": "far"}]}
    text = r"points.0.y: expected a number, got 'far'"
    with pytest.raises(BridgeError, match=text):
        talk.call("ask_scan_unseen", scan)


ROBOT = """
version: 1
bridges: {python: {}}
functions:
  ask:
    components:
      - {name: nine, bridge: python, service: {endpoint: ["tests.local.typed_parts:wrong_number"]}}
  sum:
    components:
      - name: named
        bridge: python
        parameters: {factor: 2}
        inputs:
          left: {endpoint: ["tests.local.typed_parts:Named"]}
          right: {endpoint: ["tests.local.typed_parts:Named"]}
        outputs:
          sum: {endpoint: ["tests.local.typed_parts:Named"], structure: {type: object}}
"""


def test_a_reply_that_breaks_its_structure_is_an_error_of_the_service() -> None:
    with (
        RobotManager(loads(ROBOT)) as robot,
        pytest.raises(
            BridgeError,
            match='reply of the service nine: value: expected a whole number, got "nine"',
        ) as caught,
    ):
        robot.call("ask", {"value": 1}, timeout=patience())
    assert caught.value.reason is FailureReason.BAD_MESSAGE


def test_a_class_with_named_inputs_and_outputs_needs_no_call() -> None:
    with RobotManager(loads(ROBOT)) as robot, robot.request("sum.sum") as sums:
        sums.send({"value": 1}, "left")
        assert sums.get(patience()) == {"value": 2}
        sums.send({"value": 1}, "right")
        assert sums.get(patience()) == {"value": -2}


def test_a_class_that_cannot_be_called_has_no_default_input() -> None:
    with pytest.raises(BridgeError, match="no method '__call__' for the port 'default'") as caught:
        talk.describe("Named", Role.INPUT)
    assert caught.value.reason is FailureReason.BAD_ENDPOINT


@pytest.mark.parametrize("numbers", ["2 ** 20", "0.5"])
def test_numbers_that_the_promised_type_cannot_hold_are_refused(numbers: str) -> None:
    with pytest.raises(BridgeError, match=r"int16 of the shape \(any\), got numbers"):
        talk.call("ask_small", {"of": numbers})
    assert same(talk.call("ask_small", {"of": "2 ** 10"}), [2**10])


@pytest.mark.parametrize(
    ("numbers", "given"), [("none", []), ("list", [0, 255]), ("wide", [0, 255])]
)
def test_numbers_that_the_promised_type_can_hold_may_be_of_another(
    numbers: str, given: list[int]
) -> None:
    """What numpy makes of a list that happens to be empty is of float64."""
    assert same(talk.call("ask_pixels", {"of": numbers}), given)
    with pytest.raises(BridgeError, match="got numbers that it cannot hold"):
        talk.call("ask_pixels", {"of": "beyond"})


def test_what_another_thread_is_importing_does_not_concern_plain_hints(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("numpy", "pydantic"):  # as it is in sys.modules before its first line has run
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    assert schema_of(Named)["properties"] == {"name": {"type": "string"}}
    assert is_plain(Named)


def test_nothing_heavy_is_imported_for_plain_components() -> None:

    code = (
        "import sys; from tests.local import talk, parts\n"
        "from uoarm.model import Endpoint, Role\n"
        "with talk.bridge() as made:\n"
        "    made.call(Endpoint('p', 'd', Role.SERVICE, ('tests.local.parts:double',)), "
        "{'value': 1})\n"
        "print([one for one in ('cattrs', 'numpy', 'pydantic') if one in sys.modules])"
    )
    done = run_python("-c", code, check=True)
    assert done.stdout.strip() == "[]"
