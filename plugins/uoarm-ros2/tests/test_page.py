"""The tables of the plugin's page are those of its options."""

from __future__ import annotations

from pathlib import Path

import pytest
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
