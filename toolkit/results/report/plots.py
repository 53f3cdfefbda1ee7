"""The report's plots. One colour per cell, the same in every plot (Okabe and Ito's palette)."""

from __future__ import annotations

import io
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from toolkit.files import new_file
from toolkit.results.rows import CellSummary, JudgedT, Row, by_cell, errors
from toolkit.results.stats import wilson_interval

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#B8A800", "#888888")

_RELIABILITY_BINS = 8

_STYLE: dict[Any, Any] = {
    "svg.hashsalt": "toolkit",
    "svg.fonttype": "none",
    "pdf.fonttype": 42,
    "font.family": "sans-serif",
    "font.size": 11,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.alpha": 0.18,
    "legend.frameon": False,
}
_INKED = ("axes.edgecolor", "axes.labelcolor", "xtick.color", "ytick.color", "text.color", "grid.color")
_GREY, _BLACK = "#8a8f98", "#000000"


@dataclass(frozen=True)
class Plot:
    """A plot, to be shown on the page and to be printed.

    Attributes:
        name: of its files.
        draw: draws it; what it does not colour has the colour of text.
        size: inches.
        legend: colours by name. On the page, one legend stands for all plots; a printed one has its own.
    """

    name: str
    draw: Callable[[Figure], None]
    size: tuple[float, float]
    legend: Mapping[str, str] = field(default_factory=dict[str, str])

    def svg(self) -> str:
        """SVG to stand in a page: grey and on nothing, legible on a light page and on a dark one."""
        buffer = io.StringIO()
        with self._style(_GREY):
            self._drawn(legend=False).savefig(buffer, format="svg", transparent=True, metadata=_DATELESS["svg"])
        text = buffer.getvalue()
        return text[text.index("<svg") :]

    def write(self, folder: Path) -> None:
        """Write FOLDER/<name>.svg and .pdf, in black on white."""
        with self._style(_BLACK):
            figure = self._drawn(legend=True)
            for kind, metadata in _DATELESS.items():
                with new_file(folder / f"{self.name}.{kind}") as path:
                    figure.savefig(path, format=kind, metadata=metadata)

    def _style(self, ink: str) -> Any:
        return matplotlib.rc_context({**_STYLE, **dict.fromkeys(_INKED, ink)})

    def _drawn(self, *, legend: bool) -> Figure:
        figure = Figure(figsize=self.size)
        self.draw(figure)
        if legend and self.legend:
            handles = [Line2D([], [], color=color, marker="o", label=name) for name, color in self.legend.items()]
            figure.legend(handles=handles, loc="outside lower center", ncols=min(3, len(handles)))
        # Once, for every file: a figure with an engine of its own is drawn twice each time.
        ConstrainedLayoutEngine().execute(figure)
        return figure


_DATELESS: dict[str, dict[str, Any]] = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}
"""The same run gives the same bytes, whenever its figures are written."""


def cell_colors(cells: Sequence[str]) -> dict[str, str]:
    """Colour of every cell."""
    return {cell: PALETTE[i % len(PALETTE)] for i, cell in enumerate(cells)}


def error_curves(rows: Sequence[Row], colors: dict[str, str]) -> Plot:
    """Share of objects within an error, against the error; rotation and translation side by side."""
    cells = by_cell([row for row in rows if row.in_current])
    seen_in_each = _n([len(own) for own in cells.values()])

    def draw(figure: Figure) -> None:
        panels = (
            ("rotation_error_deg_sym", "rotation error (deg)", 0.05, 180, 5),
            ("translation_error_cm_sym", "translation error (cm)", 0.01, 50, 2),
        )
        for place, (error, label, low, high, threshold) in enumerate(panels, start=1):
            axes: Any = figure.add_subplot(1, 2, place)
            for cell, color in colors.items():
                values = np.sort(errors(cells.get(cell, []), error))
                share = np.arange(1, len(values) + 1) / len(values)
                seen = np.isfinite(values)
                last = share[seen][-1] if seen.any() else 0.0
                # A curve goes on to the edge of the plot, which errors may lie beyond.
                x = np.concatenate([[low], values[seen].clip(low), [max([high, *values[seen]])]])
                axes.step(x, np.concatenate([[0], share[seen], [last]]), color=color, where="post", lw=2, label=cell)
            axes.axvline(threshold, color=matplotlib.rcParams["text.color"], lw=1, ls=":")
            axes.set(xscale="log", xlim=(low, high), ylim=(0, 1.02), xlabel=f"{label}\n{seen_in_each}")
            axes.yaxis.set_major_formatter(PercentFormatter(1))
            if place == 1:
                axes.set_ylabel("objects within")

    return Plot("errors", draw, (10, 4), colors)


def success_by(
    name: str, rows: Sequence[JudgedT], colors: dict[str, str], key: Callable[[JudgedT], Any], label: str
) -> Plot:
    """Success with its Wilson interval, by a property of the row."""
    outcomes: dict[Any, dict[str, list[bool]]] = {group: {} for group in sorted({key(row) for row in rows})}
    for row in rows:
        outcomes[key(row)].setdefault(row.cell, []).append(row.success_sym)

    def draw(figure: Figure) -> None:
        axes: Any = figure.add_subplot()
        for number, (cell, color) in enumerate(colors.items()):
            offset = 0.6 * ((number + 0.5) / len(colors) - 0.5)
            for place, own in enumerate(outcomes.values()):
                if right := own.get(cell):
                    low, high = wilson_interval(sum(right), len(right))
                    axes.plot([place + offset] * 2, [low, high], color=color, lw=1.5, alpha=0.6)
                    axes.plot(place + offset, np.mean(right), "o", color=color, ms=5)
        counts = [_n([len(right) for right in own.values()], "") for own in outcomes.values()]
        axes.set_xticks(range(len(outcomes)), [f"{group}\n{n}" for group, n in zip(outcomes, counts, strict=True)])
        axes.set(xlim=(-0.5, len(outcomes) - 0.5), ylim=(-0.02, 1.02), xlabel=label, ylabel="objects right")
        axes.yaxis.set_major_formatter(PercentFormatter(1))

    return Plot(name, draw, (max(5, 0.55 * len(outcomes)), 3.6), colors)


def confidence_curves(rows: Sequence[Row], colors: dict[str, str]) -> Plot | None:
    """Wrong answers against coverage, and right answers against stated confidence; None where no cell states any."""
    cells = {cell: [r for r in rows if r.cell == cell and r.status != "missed"] for cell in colors}
    stated = {cell: own for cell, own in cells.items() if any(row.confidence is not None for row in own)}

    def draw(figure: Figure) -> None:
        risk, reliability = figure.subplots(1, 2)
        for cell, own in stated.items():
            sure = np.array([0.0 if row.confidence is None else row.confidence for row in own])
            right = np.array([row.success_sym and row.in_current for row in own])
            order = np.argsort(-sure, kind="stable")
            answered = np.arange(1, len(own) + 1)
            risk.plot(answered / len(own), np.cumsum(~right[order]) / answered, color=colors[cell], lw=2)
            parts = [part for part in np.array_split(order[::-1], _RELIABILITY_BINS) if len(part)]
            means = [(sure[part].mean(), right[part].mean()) for part in parts]
            reliability.plot(*zip(*means, strict=True), "o-", color=colors[cell], lw=1.5)
        reliability.plot([0, 1], [0, 1], color=matplotlib.rcParams["text.color"], lw=1, ls=":")
        n = _n([len(own) for own in stated.values()])
        risk.set(xlabel=f"objects answered, most confident first\n{n}", ylabel="wrong among them", ylim=(0, None))
        reliability.set(xlabel=f"stated confidence\n{n}", ylabel="right", xlim=(0, 1.02), ylim=(0, 1.02))
        for axis in (risk.xaxis, risk.yaxis, reliability.yaxis):
            axis.set_major_formatter(PercentFormatter(1))

    return Plot("confidence", draw, (10, 3.6), {cell: colors[cell] for cell in stated}) if stated else None


def time_by_stage(summaries: Sequence[CellSummary]) -> Plot:
    """Median time per object, stacked by stage."""

    stages = list(dict.fromkeys(stage for summary in summaries for stage in summary.time_ms))
    # Twenty colours in pairs of one hue: first one of each pair, so that neighbours have different hues.
    colors = matplotlib.colormaps["tab20"]([*range(0, 20, 2), *range(1, 20, 2)])

    def draw(figure: Figure) -> None:
        axes: Any = figure.add_subplot()
        left = np.zeros(len(summaries))
        for stage, color in zip(stages, itertools.cycle(colors), strict=False):
            width = np.array([summary.time_ms.get(stage, 0.0) for summary in summaries])
            axes.barh(range(len(summaries)), width, left=left, label=stage, color=color)
            left += width
        axes.set_yticks(range(len(summaries)), [summary.cell for summary in summaries])
        axes.invert_yaxis()
        axes.set_xlabel(f"median ms per object (database's share included)\n{_n([s.objects for s in summaries])}")
        if stages:
            figure.legend(ncols=4, loc="outside lower center")

    return Plot("time", draw, (10, 2.6 + 0.42 * len(summaries)))


def _n(counts: Sequence[int], of: str = " objects in each cell") -> str:
    least, most = min(counts, default=0), max(counts, default=0)
    return f"n = {least}{of}" if least == most else f"n = {least} to {most}{of}"
