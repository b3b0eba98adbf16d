"""Plots of what the experiments recorded, as SVG.

`plots.py FOLDER` draws FOLDER/latency.json and FOLDER/monitoring.json beside them. Needs
matplotlib: the extra `uoarm[plots]`. The same figures give the same files.
"""

from __future__ import annotations

import signal

if __name__ == "__main__":  # an import may lose what Ctrl-C raises
    signal.signal(signal.SIGINT, signal.SIG_DFL)

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

try:
    import matplotlib as mpl
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure as Drawing
except ImportError as error:
    sys.exit(f"plots need the extra plots: pip install -e '.[plots]' ({error})")

_PAPER_MS = 1.0
_ROW_INCHES = 0.27
_PLACES = {"bare": "#767676", "one process": "#0b6e99", "hosts": "#c4581c"}
_WORDS = {
    "bare": "the framework alone, without uoarm",
    "one process": "uoarm, bridges in one process",
    "hosts": "uoarm, each bridge in its own process",
}
_STEP = 0.22

Figure = Mapping[str, Any]


def main(folder: Path) -> None:
    """Draw everything."""
    mpl.rcParams.update({"svg.hashsalt": "uoarm", "svg.fonttype": "none", "font.size": 9})
    latency = json.loads((folder / "latency.json").read_text(encoding="utf-8"))
    figures = latency["figures"]
    for name, title, kinds in (
        ("steps", "Functional processes", {"step"}),
        ("messages", "One message to and fro", {"floor", "alone", "pair"}),
    ):
        some = [figure for figure in figures if figure["kind"] in kinds]
        _latency(some, f"{title} ({latency['measured']})", folder / f"{name}.svg")
    deaths = json.loads((folder / "monitoring.json").read_text(encoding="utf-8"))
    _deaths(deaths["figures"], f"Each part killed ({deaths['measured']})", folder / "faults.svg")


def _latency(figures: Sequence[Figure], title: str, file: Path) -> None:
    titles = list(dict.fromkeys(figure["title"] for figure in figures))
    places = [place for place in _PLACES if any(figure["where"] == place for figure in figures)]
    drawing = Drawing(figsize=(8.5, _ROW_INCHES * len(titles) + 1.5), layout="tight")
    axes = drawing.subplots()
    named: set[str] = set()
    for row, name in enumerate(titles):
        here = [figure for figure in figures if figure["title"] == name]
        for number, mapping in enumerate(
            sorted(here, key=lambda item: places.index(item["where"]))
        ):
            at = row + _STEP * (number - (len(here) - 1) / 2)
            _whisker(axes, at, mapping, named)
    axes.axvline(_PAPER_MS, color="black", linewidth=0.8, linestyle="--")
    axes.text(_PAPER_MS, -0.8, " the paper: below 1 ms", fontsize=8, va="center")
    axes.set_xscale("log")
    axes.set_xlabel("milliseconds: dot = median, bar = 95 %, tick = 99 %")
    _rows(axes, titles)
    axes.legend(loc="lower center", bbox_to_anchor=(0.35, 1.0), ncols=len(places), fontsize=8,
                frameon=False)  # fmt: skip
    _write(drawing, title, file)


def _whisker(axes: Axes, at: float, one: Figure, named: set[str]) -> None:
    p50, p95, p99 = (1000 * one[key] for key in ("p50", "p95", "p99"))
    where, colour = one["where"], _PLACES[one["where"]]
    label = _WORDS[where] if where not in named else None
    named.add(where)
    axes.plot([p50, p95], [at, at], color=colour, linewidth=2, solid_capstyle="butt")
    axes.plot([p95, p99], [at, at], color=colour, linewidth=0.7)
    axes.plot([p99], [at], marker="|", color=colour, markersize=5)
    axes.plot([p50], [at], marker="o", color=colour, markersize=4, linestyle="", label=label)


def _deaths(deaths: Sequence[Figure], title: str, file: Path) -> None:
    titles = [f"{death['killed']}\n{death['function']}" for death in deaths]
    drawing = Drawing(figsize=(8.5, 0.5 * len(deaths) + 1.5), layout="tight")
    axes = drawing.subplots()
    for row, death in enumerate(deaths):
        noticed, silence = death["noticed"], death["silence"]
        if silence is not None:
            axes.plot([0.005, silence], [row, row], color=_PLACES["hosts"], linewidth=3, alpha=0.5)
            axes.plot([silence], [row], marker="s", color=_PLACES["hosts"], linestyle="")
        if noticed is not None:
            axes.plot([noticed], [row], marker="o", color=_PLACES["one process"], linestyle="")
        end = max(noticed or 0.005, silence or 0.005)
        axes.text(end * 1.25, row, death["went_on"], fontsize=7.5, va="center")
    axes.plot([], [], marker="o", color=_PLACES["one process"], linestyle="", label="reported")
    axes.plot([], [], marker="s", color=_PLACES["hosts"], linewidth=3, label="messages again")
    axes.set_xscale("log")
    axes.set_xlim(0.005, 200)
    axes.set_xlabel("seconds from the kill; beside it, who went on")
    _rows(axes, titles)
    axes.legend(loc="lower right", fontsize=8, frameon=False)
    _write(drawing, title, file)


def _rows(axes: Axes, titles: Sequence[str]) -> None:
    axes.set_yticks(range(len(titles)), titles, fontsize=8)
    axes.set_ylim(len(titles) - 0.4, -1.1)
    axes.xaxis.set_major_formatter(lambda number, _: f"{number:g}")
    axes.grid(axis="x", color="#dddddd", linewidth=0.5)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _write(drawing: Drawing, title: str, file: Path) -> None:
    drawing.suptitle(title, fontsize=9)
    drawing.savefig(file, metadata={"Date": None, "Creator": None})
    lines = file.read_text(encoding="utf-8").splitlines()
    file.write_text("\n".join(line.rstrip() for line in lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="what `every.py --record FOLDER` wrote")
    try:
        main(parser.parse_args().folder)
    except OSError as error:
        parser.error(str(error))
