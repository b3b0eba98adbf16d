"""Offers in the lock: what a framework has of a function is compared, and held to it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from uoarm import RobotManager
from uoarm._lock import LockOutcome, compare, read_lock, write_lock
from uoarm.bridge import Registry
from uoarm.cli._lock import lock_of
from uoarm.config import loads
from uoarm.model import OfferState
from uoarm.testing import MemoryBridge, patience

NUMBER: dict[str, Any] = {"type": "number"}
SMALL: dict[str, Any] = {"type": "number", "minimum": 0, "maximum": 9}
ROBOT = """
version: 1
bridges: {one: {plugin: python}, net: {plugin: python}}
functions:
  scan: {components: [{name: laser, bridge: one, output: {endpoint: [laser]}}]}
  drive: {components: [{name: base, bridge: one, input: {endpoint: [base]}}]}
  double: {components: [{name: doubler, bridge: one, service: {endpoint: [doubler]}}]}
offer:
  net:
    scan: {output: {endpoint: [seen]}}
    drive: {input: {endpoint: [wish]}}
    double: {service: {endpoint: [twice], request: {type: integer}}}
"""


@contextmanager
def robot(
    folder: Path, seen: Mapping[str, Any] = NUMBER, wish: Mapping[str, Any] = SMALL, mode: str = ""
) -> Iterator[RobotManager]:
    """Make a robot that offers its functions in `net`, where one listens and one commands."""
    one, net = MemoryBridge("one"), MemoryBridge("net")
    one.emitter("laser", SMALL)
    one.taker("base", NUMBER)
    one.service("doubler", {"type": "integer"}, NUMBER, lambda asked: 2 * asked)
    net.taker("seen", seen)
    net.emitter("wish", wish)
    read = loads(f"{ROBOT}{mode}", origin=str(folder / "robot.yaml"))
    with RobotManager(read, registry=Registry(()), bridges={"one": one, "net": net}) as manager:
        yield manager


def lock(folder: Path, seen: Mapping[str, Any] = NUMBER, wish: Mapping[str, Any] = SMALL) -> Path:
    path = folder / "robot.lock"
    with robot(folder, seen, wish) as manager:
        path.write_text(write_lock(lock_of(manager)), encoding="utf-8")
    return path


def test_what_frameworks_have_is_in_the_lock_and_compared(tmp_path: Path) -> None:
    before = read_lock(lock(tmp_path))
    ports = {name: sorted(offer.part.ports) for name, offer in before.offers.items()}
    assert ports == {
        "net:scan": ["input.default"], "net:drive": ["output.default"], "net:double": ["request"],
    }  # fmt: skip
    assert {finding.outcome for finding in compare(before, before)} == {LockOutcome.FITS}
    # Who listens takes less now than the laser gives, and who commands says what no base takes.
    after = read_lock(lock(tmp_path, seen={**SMALL, "maximum": 5}, wish={"type": "string"}))
    reports = {
        (finding.function, finding.subject): finding.outcome
        for finding in compare(before, after)
        if finding.outcome is not LockOutcome.FITS
    }
    assert reports == {
        ("offer net:scan", "laser.default -> net:scan.default"): LockOutcome.BREAKS,
        ("offer net:drive", "net:drive.default -> base.default"): LockOutcome.BREAKS,
    }


def test_an_offer_is_held_to_the_lock(tmp_path: Path) -> None:
    lock(tmp_path)
    wider = {**SMALL, "maximum": 8}
    with robot(tmp_path, wish=wider, mode="lock: enforce") as manager:
        states = {
            offer_status.name: offer_status for offer_status in manager.offer(timeout=patience())
        }
        assert states["net:drive"].state is OfferState.FAILED
        assert "net:drive.output.default has another structure than in" in states["net:drive"].cause
        assert states["net:scan"].state is states["net:double"].state is OfferState.OPEN
        assert [
            (difference.component, difference.refused) for difference in manager.status().lock
        ] == [("net:drive", True)]
    with robot(tmp_path, wish=wider, mode="lock: warn") as manager:
        assert {offer_status.state for offer_status in manager.offer(timeout=patience())} == {
            OfferState.OPEN
        }
        assert [
            (difference.component, difference.refused) for difference in manager.status().lock
        ] == [("net:drive", False)]
