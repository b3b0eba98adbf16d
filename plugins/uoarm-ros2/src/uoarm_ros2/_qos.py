"""Quality of service as plain values: what options ask for, what fits peers, what clashes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from attrs import evolve, frozen

from uoarm.bridge import EndpointOptions, option

KEEP_ALL_SECONDS = 10.0  # for which a history that keeps all waits for slow readers
_DEPTH = 100
_DEPTH_OF_LARGE = 5  # a queue of pictures is a delay: a hundred of 1080p are 600 MB
AUTO_ONLY: Mapping[str, object] = {"pattern": "^auto$", "examples": ["auto"]}
"""The only text that may be written where something else may be, too."""
# Nanoseconds of 64 bits count them; of less than one ROS 2 makes no limit.
_COUNTABLE = {"minimum": 1e-9, "maximum": 1_000_000_000}
_AUTO_SECONDS = {"type": ["number", "string", "null"], **_COUNTABLE, **AUTO_ONLY}


@frozen
class Policies:
    """The policies of one publisher or subscription; times in seconds, None for no limit.

    The history of peers is empty: DDS does not report it.
    """

    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"
    depth: int = _DEPTH
    deadline: float | None = None
    lifespan: float | None = None
    liveliness: str = "automatic"
    lease_duration: float | None = None

    def __str__(self) -> str:
        kept = "all" if self.history == "keep_all" else f"last {self.depth}"
        words = [self.reliability, self.durability]
        words += [f"keep {kept}"] if self.history else []
        words += [f"deadline {self.deadline:g} s"] if self.deadline is not None else []
        words += [self.liveliness] if self.liveliness != "automatic" else []
        words += [f"lease {self.lease_duration:g} s"] if self.lease_duration is not None else []
        return ", ".join(words)


def _auto(*choices: str) -> dict[str, object]:
    return {"enum": ["auto", *choices]}


@frozen
class QosOptions(EndpointOptions):
    """The policies that an endpoint's options ask for; `auto` is settled against the peers.

    A deadline or lease that is "auto" is what the peers state; None asks for none. A depth that is
    None follows from the size of the type.
    """

    reliability: str = option(
        "auto",
        _auto("reliable", "best_effort"),
        "`reliable` or `best_effort`: whether lost messages are sent again",
    )
    durability: str = option(
        "auto",
        _auto("volatile", "transient_local"),
        "`volatile` or `transient_local`: whether later readers get the last messages",
    )
    history: str = option(
        "keep_last",
        {"enum": ["keep_last", "keep_all"]},
        "or `keep_all`: the sender waits for slow readers; else the oldest message gives way",
    )
    depth: int | None = option(
        None,
        {"type": ["integer", "null"], "minimum": 1, "maximum": 1_000_000},
        f"messages that are kept; left out: {_DEPTH}, for pictures and the like {_DEPTH_OF_LARGE}",
    )
    deadline: float | str | None = option(
        "auto",
        _AUTO_SECONDS,
        "seconds until the next message must come; null: none",
        unit="s",
    )
    lifespan: float | None = option(
        None,
        {"type": ["number", "null"], **_COUNTABLE},
        "seconds after which an unread message is dropped; left out: none",
        unit="s",
    )
    liveliness: str = option(
        "auto",
        _auto("automatic", "manual_by_topic"),
        "`automatic` or `manual_by_topic`: what counts as a sign of life",
    )
    lease_duration: float | str | None = option(
        "auto",
        _AUTO_SECONDS,
        "seconds without a sign of life until a publisher is lost; null: none",
        unit="s",
    )

    def for_type(self, *, large: bool) -> QosOptions:
        """Return the options for a type, with the depth of its size if none is stated."""
        if self.depth is not None:
            return self
        return evolve(self, depth=_DEPTH_OF_LARGE if large else _DEPTH)


def for_reading(options: QosOptions, offers: Iterable[Policies]) -> Policies:
    """Return what a subscription asks so that it gets the most that all publishers offer.

    Without a publisher it asks for reliable and volatile: the default that most publishers offer.
    """
    seen = tuple(offers)
    asked = Policies(history=options.history, depth=options.depth or _DEPTH)
    if any(offer.reliability == "best_effort" for offer in seen):
        asked = evolve(asked, reliability="best_effort")
    if seen and all(offer.durability == "transient_local" for offer in seen):
        asked = evolve(asked, durability="transient_local")
    if seen and all(offer.liveliness == "manual_by_topic" for offer in seen):
        asked = evolve(asked, liveliness="manual_by_topic")
    leases = [offer.lease_duration for offer in seen if offer.lease_duration is not None]
    lease = max(leases) if leases and len(leases) == len(seen) else None
    return _settled(asked, options, deadline=None, lease=lease)


def for_writing(options: QosOptions, requests: Iterable[Policies]) -> Policies:
    """Return what a publisher offers so that every subscription is served as it asks."""
    seen = tuple(requests)
    depth = options.depth or _DEPTH
    offered = Policies(history=options.history, depth=depth, lifespan=options.lifespan)
    if any(request.durability == "transient_local" for request in seen):
        offered = evolve(offered, durability="transient_local")
    if any(request.liveliness == "manual_by_topic" for request in seen):
        offered = evolve(offered, liveliness="manual_by_topic")
    deadlines = [policies.deadline for policies in seen if policies.deadline is not None]
    leases = [policies.lease_duration for policies in seen if policies.lease_duration is not None]
    return _settled(
        offered, options, deadline=min(deadlines, default=None), lease=min(leases, default=None)
    )


def _settled(
    found: Policies, options: QosOptions, *, deadline: float | None, lease: float | None
) -> Policies:
    """Let every policy that the options state override what was found."""
    return evolve(
        found,
        reliability=found.reliability if options.reliability == "auto" else options.reliability,
        durability=found.durability if options.durability == "auto" else options.durability,
        liveliness=found.liveliness if options.liveliness == "auto" else options.liveliness,
        deadline=deadline if isinstance(options.deadline, str) else options.deadline,
        lease_duration=lease if isinstance(options.lease_duration, str) else options.lease_duration,
    )


def clashes(offered: Policies, requested: Policies) -> tuple[str, ...]:
    """Name every policy on which a publisher and a subscription cannot meet."""
    found = []
    if offered.reliability == "best_effort" and requested.reliability == "reliable":
        found.append("reliability (offered best_effort, asked reliable)")
    if offered.durability == "volatile" and requested.durability == "transient_local":
        found.append("durability (offered volatile, asked transient_local)")
    if offered.liveliness == "automatic" and requested.liveliness == "manual_by_topic":
        found.append("liveliness (offered automatic, asked manual_by_topic)")
    for name, here, there in (
        ("deadline", offered.deadline, requested.deadline),
        ("lease_duration", offered.lease_duration, requested.lease_duration),
    ):
        if there is not None and (here is None or here > there):
            offer = "none" if here is None else f"{here:g} s"
            found.append(f"{name} (offered {offer}, asked {there:g} s)")
    return tuple(found)
