"""Draws how soon vehicles stood after each death, as SVG.

    python examples/warehouse/experiments/stopping.py --json > stopping.json
    python examples/warehouse/experiments/drawing.py stopping.json stopping.svg

Needs matplotlib: the extra `uoarm[plots]`. The same figures give the same file.
"""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import argparse
import json
import sys
from pathlib import Path
from typing import Any, Final

try:
    import matplotlib as mpl
    from matplotlib.figure import Figure
except ImportError as error:
    sys.exit(f"plots need the extra plots: pip install -e '.[plots]' ({error})")

_COLOURS: Final = {"amr": "#0b6e99", "cart": "#c4581c", "agv": "#2a7d2a", "visitor": "#767676"}
_NAMES: Final = {
    "amr": "amr, ROS 2",
    "cart": "cart, OpenRTM",
    "agv": "agv, VDA 5050 2.1",
    "visitor": "visitor, VDA 5050 3.0",
}


def draw(measured: dict[str, Any], file: Path) -> None:
    """Draw a row for each part that was killed, and a dot for each vehicle that drove then."""
    mpl.rcParams.update({"svg.hashsalt": "uoarm", "svg.fonttype": "none", "font.size": 9})
    ((_, rows),) = measured["tables"].items()
    parts = list(dict.fromkeys(row["killed"] for row in rows))
    drawing = Figure(figsize=(7.0, 0.3 * len(parts) + 1.3), layout="tight")
    axes = drawing.subplots()
    for name, colour in _COLOURS.items():
        dots = [
            (float(row["stands after"].removesuffix(" s")), parts.index(row["killed"]))
            for row in rows
            if row["vehicle"] == name and row["stands after"].endswith(" s")
        ]
        seconds, places = [value for value, _ in dots], [number for _, number in dots]
        axes.plot(seconds, places, "o", color=colour, label=_NAMES[name])
    axes.set_yticks(range(len(parts)), parts)
    axes.set_ylim(len(parts) - 0.5, -0.5)
    axes.set_xlim(left=0)
    axes.set_xlabel("seconds from the kill until the vehicle stands")
    axes.grid(axis="x", color="#dddddd", linewidth=0.5)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="lower right", fontsize=8, frameon=False)
    first, last = measured["load"]
    drawing.suptitle(
        f"{measured['measured']}, {measured['cores']} cores, load {first} to {last}", size=9
    )
    drawing.savefig(file, metadata={"Date": None, "Creator": None})
    lines = file.read_text(encoding="utf-8").splitlines()
    file.write_text("\n".join(line.rstrip() for line in lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("figures", type=Path, help="what `stopping.py --json` printed")
    parser.add_argument("plot", type=Path, help="SVG file that is made")
    given = parser.parse_args()
    try:
        draw(json.loads(given.figures.read_text(encoding="utf-8")), given.plot)
    except OSError as error:
        parser.error(str(error))
