"""A device in Node.js, written from the page of the profile alone, works with the plugin."""

from __future__ import annotations

import select
import shutil
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from lines import LIMIT, PseudoTerminal
from rigs import Events, bridged, endpoint

from uoarm.bridge import Bridge
from uoarm.errors import BridgeError, FailureReason
from uoarm.model import Health

DEVICE = Path(__file__).parents[3] / "examples" / "vitals" / "thermometer.js"
NODE = shutil.which("node")
FLOW = endpoint("thermometer", "bodyTemperature")
PLACE = endpoint("thermometer", "choosePlace", "service")

pytestmark = pytest.mark.needs("node")


@contextmanager
def thermometer(*words: str) -> Iterator[str]:
    """The device as a process; what it prints."""
    assert NODE
    command = [NODE, str(DEVICE), *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        try:
            yield process.stdout.readline().strip()
        finally:
            process.kill()


@contextmanager
def cable(one: PseudoTerminal, two: PseudoTerminal) -> Iterator[None]:
    """A null-modem cable between two ports."""
    stop = threading.Event()

    def carry() -> None:
        while not stop.is_set():
            for end in select.select([one, two], [], [], 0.05)[0]:
                data = end.read_some()
                (two if end is one else one).write(data)

    thread = threading.Thread(target=carry, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join(LIMIT)


def check(bridge: Bridge, events: Events) -> None:
    got = Events()
    structure = bridge.describe(FLOW).message
    assert structure
    assert structure.schema == structure_of_page()
    source = bridge.open_source(FLOW, structure, got)
    first = got.get()
    assert 36.5 <= first["temperature"] <= 37.1
    assert first["place"] == "ear"
    assert bridge.call(PLACE, {"place": "mouth"}) == {"before": "ear"}
    got.until(lambda item: item["place"] == "mouth")
    source.close()
    with pytest.raises(BridgeError) as raised:
        bridge.describe(endpoint("thermometer", "bodyWeight"))
    assert raised.value.reason is FailureReason.NOT_FOUND
    assert Health.LOST not in {event.health for event in list(events.queue.queue)}


def structure_of_page() -> object:
    return {
        "type": "object",
        "properties": {
            "temperature": {"type": "number", "minimum": 20.0, "maximum": 45.0, "x-unit": "Cel"},
            "place": {"type": "string", "enum": ["ear", "mouth"]},
        },
        "required": ["temperature", "place"],
        "additionalProperties": False,
    }


def test_over_tcp() -> None:
    with thermometer("--tcp", "0") as url, bridged(thermometer={"url": url}) as (bridge, events):
        check(bridge, events)


def test_over_a_serial_line_from_one_host_to_the_next() -> None:
    with (
        PseudoTerminal() as host,
        PseudoTerminal() as device,
        cable(host, device),
        thermometer("--serial", device.path),
    ):
        for _ in range(2):
            with bridged(thermometer={"url": host.path}) as (bridge, events):
                check(bridge, events)
                bridge.call(PLACE, {"place": "ear"})
