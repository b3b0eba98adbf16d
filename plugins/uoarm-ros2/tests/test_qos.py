"""Quality of service as values: `auto` fits every peer, and clashes are found and named."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from uoarm_ros2._options import Ros2Options
from uoarm_ros2._qos import Policies, QosOptions, clashes, for_reading, for_writing

TIMES = st.none() | st.floats(0.001, 100.0)
POLICIES = st.builds(
    Policies,
    reliability=st.sampled_from(["reliable", "best_effort"]),
    durability=st.sampled_from(["volatile", "transient_local"]),
    deadline=TIMES,
    liveliness=st.sampled_from(["automatic", "manual_by_topic"]),
    lease_duration=TIMES,
)


@given(st.lists(POLICIES, max_size=4))
def test_auto_reads_from_every_publisher(offers: list[Policies]) -> None:
    asked = for_reading(QosOptions(), offers)
    assert not any(clashes(offer, asked) for offer in offers)


@given(st.lists(POLICIES, max_size=4))
def test_auto_serves_every_subscription(requests: list[Policies]) -> None:
    offered = for_writing(QosOptions(), requests)
    assert not any(clashes(offered, request) for request in requests)


@given(st.lists(POLICIES, min_size=1, max_size=4))
def test_auto_asks_for_the_most_that_all_offer(offers: list[Policies]) -> None:
    asked = for_reading(QosOptions(), offers)
    assert (asked.reliability == "reliable") == all(o.reliability == "reliable" for o in offers)
    assert (asked.durability == "transient_local") == all(
        o.durability == "transient_local" for o in offers
    )


@given(POLICIES, st.lists(POLICIES, max_size=3))
def test_what_is_stated_is_kept(stated: Policies, peers: list[Policies]) -> None:
    options = QosOptions(
        reliability=stated.reliability,
        durability=stated.durability,
        deadline=stated.deadline,
        liveliness=stated.liveliness,
        lease_duration=stated.lease_duration,
    )
    for settled in (for_reading(options, peers), for_writing(options, peers)):
        assert (settled.reliability, settled.durability) == (stated.reliability, stated.durability)
        assert (settled.deadline, settled.liveliness) == (stated.deadline, stated.liveliness)
        assert settled.lease_duration == stated.lease_duration


@pytest.mark.parametrize(
    ("offered", "requested", "words"),
    [
        ({"reliability": "best_effort"}, {}, "reliability (offered best_effort, asked reliable)"),
        ({}, {"durability": "transient_local"}, "durability (offered volatile, asked transient"),
        ({}, {"deadline": 1.0}, "deadline (offered none, asked 1 s)"),
        ({"deadline": 2.0}, {"deadline": 1.0}, "deadline (offered 2 s, asked 1 s)"),
        ({}, {"liveliness": "manual_by_topic"}, "liveliness (offered automatic, asked manual"),
        ({"lease_duration": 2.0}, {"lease_duration": 1.0}, "lease_duration (offered 2 s, asked 1"),
    ],
)
def test_each_clash_is_named(
    offered: dict[str, object], requested: dict[str, object], words: str
) -> None:
    (found,) = clashes(Policies(**offered), Policies(**requested))  # type: ignore[arg-type]  # a table
    assert found.startswith(words)
    assert not clashes(Policies(**requested), Policies(**requested))  # type: ignore[arg-type]  # a table


@pytest.mark.parametrize("options", [{}, {"qos": "auto"}, {"qos": {}}])
def test_nothing_said_is_auto(options: dict[str, object]) -> None:
    assert Ros2Options.of(options).policies == QosOptions()


def test_policies_are_shown_in_words() -> None:
    shown = str(Policies(durability="transient_local", depth=1, deadline=0.5))
    assert shown == "reliable, transient_local, keep last 1, deadline 0.5 s"
