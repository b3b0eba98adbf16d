"""Writing a change into a file: its comments, order and spelling stay, and nothing else is lost."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from uoarm.config import compare, is_same, loads, rewrite
from uoarm.errors import ConfigurationError

FILE = """\
# The robot of the lab.
version: 1

bridges:
  # on the arm
  arm: {plugin: memory}
  head: {plugin: memory}  # the new one

functions:
  camera:
    # tried first
    components:
      - name: best
        bridge: head
        priority: 2  # by a test in March
        output: {endpoint: [best]}
      # never seen broken
      - name: spare
        bridge: arm
        output: {endpoint: [spare]}

  lamp:
    components:
    - {name: light, bridge: arm, output: {endpoint: [light]}}
# The end.
"""


def part(name: str, bridge: str = "arm", priority: int = 0) -> str:
    return (
        f"{{name: {name}, bridge: {bridge}, priority: {priority}, output: {{endpoint: [{name}]}}}}"
    )


def robot(**functions: list[str]) -> str:
    text = "".join(
        f"  {name}:\n    components:\n"
        + "".join(f"    - {component}\n" for component in components)
        for name, components in functions.items()
    )
    bridges = "bridges: {arm: {plugin: memory}, head: {plugin: memory}}"
    return f"version: 1\n{bridges}\nfunctions:\n{text}"


def without_comments(text: str) -> str:
    return "\n".join(line.partition("#")[0].rstrip() for line in text.splitlines())


LIKE_FILE = {"camera": [part("best", "head", 2), part("spare")], "lamp": [part("light")]}


def test_what_is_the_same_stays_to_the_letter() -> None:
    assert rewrite(FILE, robot(**LIKE_FILE)) == FILE


def test_one_value_is_one_line_and_keeps_its_comment() -> None:
    wanted = FILE.replace("priority: 2  # by a test in March", "priority: 3")
    assert rewrite(FILE, without_comments(wanted)) == FILE.replace("priority: 2 ", "priority: 3 ")


@pytest.mark.parametrize(
    "line", ["map: {v: {const: {}}}", "map: {v: {from: v, default: {}}}", "parameters: {n: {}}"]
)
def test_a_number_is_no_truth_value_and_a_float_no_integer(line: str) -> None:
    own, inner = ("", line) if line.startswith("map") else (line, "")
    fed = ["      - name: fed  # last", "        bridge: arm", f"        {own}",
           "        inputs:", "          x:", "            endpoint: [x]",
           "            from: camera", f"            {inner}",
           "        output: {endpoint: [y]}"]  # fmt: skip
    text = FILE.replace("{plugin: memory}", "{plugin: python}") + "\n".join(
        ["  other:", "    components:", *(line for line in fed if line.strip()), ""]
    )
    one, *others = (text.replace("{}", value) for value in ("1", "1.0", "true"))
    for other in others:
        assert compare(loads(one), loads(other)).changes == ("~ component fed",)
        assert not is_same(loads(one), loads(other))
        assert rewrite(one, without_comments(other)) == other


def test_items_whose_names_are_no_texts_are_written_as_a_whole() -> None:
    parameters = """\
        parameters:
          tools:
            - name: [left]
              size: 1
"""
    own = FILE.replace("        priority: 2", parameters + "        priority: 2")
    wanted = without_comments(own).replace("size: 1", "size: 2")
    assert rewrite(own, wanted) == own.replace("size: 1", "size: 2")


def test_ends_of_lines_stay_as_they_are() -> None:
    own = FILE.replace("\n", "\r\n")
    wanted = without_comments(FILE.replace("priority: 2", "priority: 3"))
    assert rewrite(own, wanted) == own.replace("priority: 2", "priority: 3")


def test_what_is_new_stands_behind_and_what_is_gone_takes_no_comment_of_others_with_it() -> None:
    camera = [*LIKE_FILE["camera"], part("third")]
    made = rewrite(FILE, robot(camera=camera, torch=[part("torch")]))
    assert "      - {name: third, bridge: arm, priority: 0" in made
    assert "lamp" not in made
    assert made.index("  torch:") > made.index("third")
    for comment in ("# The robot of the lab.", "# on the arm", "# never seen broken", "# The end."):
        assert comment in made


def test_what_was_made_from_the_file_is_written_as_it_is() -> None:
    edited = FILE.replace("# tried first", "# tried first\n    # and looked at").replace(
        "2  #", "9  #"
    )
    assert rewrite(FILE, edited) == edited


def test_what_cannot_be_done_line_by_line_is_refused() -> None:
    shared = FILE.replace("{plugin: memory}  # the new", "{plugin: &one memory}  # the new")
    shared = shared.replace("[spare]", "[*one]")
    wanted = without_comments(FILE.replace("head: {plugin: memory}", "head: {plugin: python}"))
    with pytest.raises(ConfigurationError, match="line by line"):
        rewrite(shared, wanted.replace("[spare]", "[memory]"))


NAMES = st.lists(st.sampled_from(["a", "b", "c", "d"]), unique=True, min_size=1)
FUNCTIONS = st.dictionaries(
    st.sampled_from(["one", "two", "three"]), st.tuples(NAMES, st.integers(0, 3)), min_size=1
)


def made_of(functions: dict[str, tuple[list[str], int]]) -> str:
    return robot(
        **{
            name: [part(f"{name}_{text}", priority=priority) for text in names]
            for name, (names, priority) in functions.items()
        }
    )


@settings(max_examples=12)
@given(FUNCTIONS, FUNCTIONS)
def test_whatever_changes_is_what_is_read_again(
    before: dict[str, tuple[list[str], int]], after: dict[str, tuple[list[str], int]]
) -> None:
    old = made_of(before).replace("functions:", "# kept\nfunctions:")
    made = rewrite(old, made_of(after))
    assert is_same(loads(made), loads(made_of(after)))
    assert "# kept" in made
