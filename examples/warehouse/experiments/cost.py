"""What the domain costs: lines that are not empty, by place.

python examples/warehouse/experiments/cost.py
"""

from __future__ import annotations

from experiment import EXAMPLE, Tables, options

PLACES = {
    "component for ROS 2": ["warehouse_parts/ros.py"],
    "component for OpenRTM": ["warehouse_parts/rtm.py"],
    "component for VDA 5050": ["warehouse_parts/vda.py"],
    "messages of all three": ["warehouse_parts/messages.py"],
    "configuration": ["robot.yaml"],
    "types in IDL": ["warehouse.idl"],
    "the station's catalogue": ["warehouse_station/station.xml"],
    "the application: state machines, journal, connections": [
        "warehouse_orders/*.py",
        "warehouse_parts/orders.py",
    ],
    "the page and the terminal client": ["browser/*", "terminal/*"],
    "for want of a real warehouse: the simulator": ["warehouse_floor/*.py"],
    "the vehicles' programs": ["warehouse_vehicles/*.py"],
    "the station's program": ["warehouse_station/*.py"],
    "what starts and ends all of it": ["warehouse_scene/*.py", "warehouse.py"],
}


def lines(pattern: str) -> int:
    """Return how many lines that are not empty some files have."""
    texts = [file.read_text(encoding="utf-8") for file in sorted(EXAMPLE.glob(pattern))]
    return sum(bool(line.strip()) for text in texts for line in text.splitlines())


if __name__ == "__main__":
    tables = Tables(options(__doc__).json)
    counted = {place: sum(map(lines, patterns)) for place, patterns in PLACES.items()}
    tables.add(
        "What the domain costs", [{"place": name, "lines": counted[name]} for name in counted]
    )
    tables.print()
