"""Lines that are added to a configuration: nothing else in it changes."""

from __future__ import annotations

import pytest

from uoarm.config import loads, merge
from uoarm.errors import ConfigurationError

OWN = """\
# The robot of room 12.
version: 1
functions:   # what applications ask for
    camera:  # the good one
        components:
          - {name: head, bridge: lab, output: {endpoint: [head]}}   # on the shelf

# Ours, do not touch.
bridges:
  lab: {plugin: memory}
"""
SUGGESTED = """\
# Read it first.
version: 1
bridges:
  far: {plugin: memory}
functions:
  camera:  # known already
    components:
      - name: other
        bridge: lab
        output: {endpoint: [other]}
  torch:  # torch of far
    components:
      - name: torch
        bridge: far
        # proven: it fits
        outputs:
          light: {endpoint: [torch]}
"""


def test_lines_are_added_and_all_others_stay() -> None:
    merged = merge(OWN, SUGGESTED)
    robot = loads(merged)
    assert list(robot.functions) == ["camera", "torch"]
    assert list(robot.bridges) == ["lab", "far"]
    assert robot.functions["camera"] == loads(OWN).functions["camera"]
    left = iter(merged.splitlines())
    assert all(line in left for line in OWN.splitlines())  # in this order
    assert "    torch:  # torch of far\n" in merged
    assert "          # proven: it fits\n" in merged
    assert merge(merged, SUGGESTED) == merged


@pytest.mark.parametrize("end", ["", "\n"])
def test_sections_may_be_empty(end: str) -> None:
    own = f"version: 1\nbridges: {{}}  # none yet\nfunctions: {{}}{end}"
    merged = merge(own, SUGGESTED.replace("lab", "far"))
    assert list(loads(merged).functions) == ["camera", "torch"]
    assert "bridges:  # none yet\n  far: {plugin: memory}\n" in merged


def test_what_is_in_braces_is_refused() -> None:
    own = OWN.replace("bridges:\n  lab: {plugin: memory}", "bridges: {lab: {plugin: memory}}")
    with pytest.raises(ConfigurationError, match="`bridges` is written in braces"):
        merge(own, SUGGESTED)


@pytest.mark.parametrize("end", ["", "\r\n"])
def test_ends_of_lines_stay_as_they_are(end: str) -> None:
    own = OWN.replace("\n", "\r\n").removesuffix("\r\n") + end
    merged = merge(own, SUGGESTED)
    assert list(loads(merged).functions) == ["camera", "torch"]
    assert merged.count("\n") == merged.count("\r\n")
    suggested = SUGGESTED.replace("lab", "far")
    assert merge(f"\ufeff{end}# nothing yet", suggested).endswith(suggested)
