"""Values of `.msg`, `.srv` and `.action` files, by the rules of `rosidl_adapter`."""

from __future__ import annotations

import contextlib
import io
from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from uoarm_ros2._message_file import ParsedMessage, parse_file
from uoarm_ros2._types import ScalarType, StringType

MESSAGE = ["p/msg/M"]
PARTS = {
    "msg": MESSAGE,
    "srv": ["p/srv/M_Request", "p/srv/M_Response"],
    "action": ["p/action/M_Goal", "p/action/M_Result", "p/action/M_Feedback"],
}


def constants(text: str) -> Any:
    (parsed,) = parse_file(text, MESSAGE)
    return parsed.constants


def defaults(text: str) -> list[object]:
    (parsed,) = parse_file(text, MESSAGE)
    return [member.default for member in parsed.members]


def test_values_are_read_by_their_type_and_not_by_their_looks() -> None:
    text = "int32 A=010\nstring B=010\nbool C=1\nfloat32 D=1\nstring NONE=\nbyte E=0x1F\nchar F=65"
    assert repr(constants(text)) == repr(
        {"A": 10, "B": "010", "C": True, "D": 1.0, "NONE": "", "E": 31, "F": 65}
    )
    text = "int8[] e []\nbool[] b []\nfloat32[] d []\nstring[] s []\nstring t []\nint8 none"
    assert defaults(text) == [[], [], [], [], "[]", None]
    text = "bool[<=2] a [0, TRUE]\nstring[2] b ['a, b', \"c\"]\nfloat64 c -inf"
    assert defaults(text) == [[False, True], ["a, b", "c"], float("-inf")]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("uint8 a 300", "expected a whole number from 0 to 255, got '300'"),
        ("int32 a abc", "expected a whole number from -2147483648 to 2147483647, got 'abc'"),
        ("bool a yes", "expected true, false, 1 or 0"),
        ("float32 a 1,5", "expected a number"),
        ("byte A=-1", "from 0 to 255"),
        ("int8[2] a [1]", "expected 2 elements, got 1"),
        ("int8[<=2] a [1, 2, 3]", "expected at most 2 elements, got 3"),
        ("int8[] a 1", "expected the default of an array as [1, 2], got '1'"),
        ("string<=3 a abcd", "expected at most 3 characters, got 4"),
        ('string a "it"s"', 'a " within " is written \\"'),
        ("std_msgs/Header a 1", "a field that is a message has no default"),
        ("std_msgs/msg/Header a", "another message is named package/Name"),
        ("time a", "ROS 2 has no type time, but builtin_interfaces/Time"),
        ("int8 aB", "'aB' is no name of a field"),
        ("int8 A 1", "a constant is written A=..."),
        ("int8 a=1", "'a' is no name of a constant"),
        ("string<=3 A=a", "a constant is a number, a bool or a string"),
        ("int8[0] a", "must be a whole number above 0, got '0'"),
        (" int8 a", "a line must not begin with blanks"),
        ("int8", "is no field, constant or comment"),
    ],
)
def test_what_does_not_fit_its_type_is_an_error_with_its_line(line: str, words: str) -> None:
    with pytest.raises(ValueError, match=r"^line 2: ") as caught:
        parse_file(f"# first\n{line}\nint8 last\n", MESSAGE)
    assert words in str(caught.value)


def test_a_name_is_defined_once() -> None:
    with pytest.raises(ValueError, match="line 3: 'int8 a': line 1 defines a already"):
        parse_file("int8 a\n\nint8 a\n", MESSAGE)
    with pytest.raises(ValueError, match="line 2: 'int8 A=2': line 1 defines A already"):
        parse_file("int8 A=1\nint8 A=2\n", MESSAGE)
    both = parse_file("int8 a\n---\nint8 a\n", PARTS["srv"])
    assert [member.line for part in both for member in part.members] == [1, 3]


def test_what_is_wrong_with_the_file_itself_is_said() -> None:
    with pytest.raises(ValueError, match="byte order mark"):
        parse_file("\N{BYTE ORDER MARK}int8 a\n", MESSAGE)
    with pytest.raises(
        ValueError, match=r"1 parts .*, not 2; nothing may stand beside --- \(line 2\)"
    ):
        parse_file("int8 a\n--- \nint8 b\n", PARTS["srv"])
    with pytest.raises(ValueError, match="'my_name' is neither a type of ROS 2 nor the name of a"):
        parse_file("int8 a\n", ["p/msg/my_name"])
    with pytest.raises(ValueError, match="the folder 'p-main' is no name of a package"):
        parse_file("int8 a\n", ["p-main/msg/M"])


KINDS = [
    *("bool", "byte", "char", "float32", "float64", "int8", "uint8", "int16", "uint16"),
    *("int32", "uint32", "int64", "uint64", "string", "wstring", "string<=3", "wstring<=2"),
]
ODD_KINDS = [
    *("Header", "std_msgs/Header", "std_msgs/msg/Header", "string<=0", "string<=x", "string<=+4"),
    *("int8<=3", "foo", "foo/Bar", "Foo/Bar", "Foo_Request", "Foo_", "foo__x/Bar", "int", "Int8"),
    *("\N{BYTE ORDER MARK}int8", "a/b/C", "/Foo", "p/", "[]"),
]
LENGTHS = ["", "", "[]", "[2]", "[<=2]", "[3]"]
ODD_LENGTHS = ["[0]", "[<=0]", "[x]", "[<=]", "[+2]", "[2", "2]", "[][]", "[0x2]", "[1_0]", "[<2]"]
NAMES = [*"abcd", *"ABCD", "a1", "a_b", "N0", "NONE", "TRUE", "class"]
ODD_NAMES = ["a__b", "a_", "_a", "1a", "aB", "é", "a-b", "A__B", "A_", "Ab", "a.b", ""]
NUMBERS = [
    *("0", "1", "-1", "+5", "010", "007", "0x1F", "0X1f", "0o17", "0b11", "1_0", "1__0", "_1"),
    *(str(n) for bits in (7, 8, 15, 16, 31, 32, 63, 64) for n in (2**bits - 1, 2**bits)),
    *(str(n) for bits in (7, 15, 31, 63) for n in (-(2**bits), -(2**bits) - 1)),
    *("1.0", "1.", ".5", "1e3", "1E-3", "1e400", "1e39", "nan", "inf", "-inf", "Infinity", "1_0.5"),
    *("0x1p3", "1,5", "true", "True", "FALSE", "yes", "\N{ARABIC-INDIC DIGIT ONE}", "0x", "- 1"),
]
TEXTS = [
    *("", "abc", '"abc"', "'abc'", '"a', 'a"', '"', "''", '"a"b"', r'"a\"b"', r'"a\"b\"c"'),
    *(r"'it\'s'", "'it''s'", "a b c", '"# x"', "=", '"a=b"', "a\\", "\N{SNOWMAN}", '"\\t"', "None"),
]
LISTS = [
    *("[]", "[ ]", "[1,]", "[,1]", "[a b, c]", '["a, b", "c"]', r'["a\"b", "c"]', "[1, 2", "1, 2]"),
    *(r'["a\"b\"c", "d"]', '["a" "b"]', "[\"a\"'b']", '["a]', '["a", ]', '[ "a"]', '["a" , "b"]'),
    *("[[1], [2]]", "(1, 2)", "[\"'a'\", b]"),
]


def mostly(common: list[str], odd: list[str]) -> st.SearchStrategy[str]:
    return st.integers(0, 11).flatmap(lambda n: st.sampled_from(common if n else odd))


elements = st.lists(st.sampled_from([*NUMBERS, *TEXTS]), max_size=3).map(
    lambda found: f"[{', '.join(found)}]"
)
values = st.one_of(
    st.sampled_from(NUMBERS), st.sampled_from(TEXTS), st.sampled_from(LISTS), elements
)
lines = st.builds(
    lambda lead, kind, length, gap, name, middle, value, end: (
        f"{lead}{kind}{length}{gap}{name}{middle}{value}{end}"
    ),
    mostly([""], [" ", "\t"]),
    mostly(KINDS, ODD_KINDS),
    mostly(LENGTHS, ODD_LENGTHS),
    mostly([" ", "  ", "\t"], [""]),
    mostly(NAMES, ODD_NAMES),
    st.sampled_from(["", " ", " ", "=", "=", " = "]),
    values,
    mostly([""], [" ", " # c", "# c", "\x0c", "\N{NO-BREAK SPACE}", ' # "x" = 3']),
)
bare_lines = st.sampled_from(
    ["", "# c", "  # c", "\t", "---", "--- ", "#", "?", "int8", "=", "\x0b"]
)


@given(
    st.lists(st.one_of(lines, lines, lines, bare_lines), max_size=3),
    st.sampled_from([("msg", 0), ("msg", 0), ("srv", 1), ("srv", 1), ("action", 2), ("srv", 2)]),
)
@example(["int32 A=010", "int8[] e []", "string NONE="], ("msg", 0))
@example([r'string[] a ["a\"b\"c", "d"]'], ("msg", 0))
def test_files_are_read_as_rosidl_adapter_reads_them(
    content: list[str], kind: tuple[str, int]
) -> None:
    text = "\n".join([*content, *(["---"] * kind[1])])
    wanted = by_rosidl(text, kind[0])
    try:
        found = [plain(part) for part in parse_file(text, PARTS[kind[0]])]
    except ValueError:
        assert wanted is None, text
    else:
        # By their writing: nan is not equal to itself, and true is to 1.
        assert repr(found) == repr(wanted), text


def by_rosidl(text: str, kind: str) -> list[object] | None:
    """Return what rosidl_adapter reads; None: it refuses the text."""
    parser = pytest.importorskip("rosidl_adapter.parser", reason="comes with the wheels of ROS 2")
    with contextlib.redirect_stderr(io.StringIO()):
        try:
            if kind == "msg":
                parts = [parser.parse_message_string("p", "M", text)]
            elif kind == "srv":
                found = parser.parse_service_string("p", "M", text)
                parts = [found.request, found.response]
            else:
                found = parser.parse_action_string("p", "M", text)
                parts = [found.goal, found.result, found.feedback]
        except Exception:  # noqa: BLE001 - rosidl refuses by exceptions of many kinds
            return None
    return [
        (
            [
                (
                    field.name,
                    _name(field.type),
                    field.type.string_upper_bound,
                    field.type.is_array,
                    field.type.array_size,
                    bool(field.type.is_fixed_size_array()),
                    field.default_value,
                )
                for field in part.fields
            ],
            [(constant.name, constant.value) for constant in part.constants],
        )
        for part in parts
    ]


def _name(kind: Any) -> str:
    if kind.pkg_name is not None:
        return f"{kind.pkg_name}/msg/{kind.type}"
    return "uint8" if kind.type == "char" else str(kind.type)


def plain(parsed: ParsedMessage) -> object:
    fields = []
    for member in parsed.members:
        kind, element = member.kind, member.kind.element
        bound = element.bound if isinstance(element, StringType) else None
        if isinstance(element, StringType):
            name = "wstring" if element.wide else "string"
        else:
            name = element.name if isinstance(element, ScalarType) else element
        fields.append((member.name, name, bound, kind.many, kind.size, kind.fixed, member.default))
    return fields, list(parsed.constants.items())
