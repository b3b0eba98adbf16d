"""The tables of the plugin's page are those of its options."""

from __future__ import annotations

from pathlib import Path

import pytest
from jsonschema import Draft202012Validator
from uoarm_ros2._options import Ros2BridgeOptions, Ros2Options
from uoarm_ros2._qos import QosOptions

from uoarm.bridge import DeclaredOptions, options_table

PAGE = Path(__file__).parents[3] / "docs" / "ros2.md"


@pytest.mark.parametrize(
    ("kind", "heading"),
    [(Ros2Options, "option"), (QosOptions, "policy"), (Ros2BridgeOptions, "option")],
)
def test_the_table_of_options_is_the_one_of_the_page(
    kind: type[DeclaredOptions], heading: str
) -> None:
    assert options_table(kind.schema(), heading) in PAGE.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("namespace", "is_valid"),
    [("", True), ("/", True), ("left", True), ("/left/arm_2", True)]
    + [(namespace, False) for namespace in ("2nd", "/left/", "//left", "left arm", "/left/2")],
)
def test_what_no_node_can_have_as_its_namespace_is_refused(namespace: str, is_valid: bool) -> None:
    options = Draft202012Validator(Ros2BridgeOptions.schema())
    assert options.is_valid({"namespace": namespace}) is is_valid
