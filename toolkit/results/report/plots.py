"""The report's plots, as SVG text. One colour per cell, the same in every plot (Okabe and Ito's palette)."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from toolkit.results.rows import CellSummary, JudgedT, Row, errors
from toolkit.results.stats import wilson_interval

PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#B8A800", "#888888")

_RELIABILITY_BINS = 8

_STYLE: dict[Any, Any] = {
    "svg.hashsalt": "toolkit",
    "svg.fonttype": "none",
    "font.family": "sans-serif",
    "font.size": 11,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8a8f98",
    "axes.labelcolor": "#8a8f98",
    "xtick.color": "#8a8f98",
    "ytick.color": "#8a8f98",
    "text.color": "#8a8f98",
    "axes.grid": True,
    "grid.color": "#8a8f98",
    "grid.alpha": 0.18,
    "legend.frameon": False,
    "legend.labelcolor": "#8a8f98",
}
"""Grey text and no background: the same picture is legible on a light and on a dark page."""


def cell_colors(cells: Sequence[str]) -> dict[str, str]:
    """Colour of every cell."""
    return {cell: PALETTE[i % len(PALETTE)] for i, cell in enumerate(cells)}


def error_curves(rows: Sequence[Row], colors: dict[str, str]) -> str:
    """Share of objects within an error, against the error; rotation and translation side by side."""

    def draw(figure: Figure) -> None:
        panels = (
            ("rotation_error_deg_sym", "rotation error (deg)", 0.05, 180, 5),
            ("translation_error_cm_sym", "translation error (cm)", 0.01, 50, 2),
        )
        for place, (field, label, low, high, threshold) in enumerate(panels, start=1):
            axes: Any = figure.add_subplot(1, 2, place)
            for cell, color in colors.items():
                values = np.sort(errors([row for row in rows if row.cell == cell and row.in_current], field))
                share = np.arange(1, len(values) + 1) / len(values)
                seen = np.isfinite(values)
                last = share[seen][-1] if seen.any() else 0.0
                x = np.concatenate([[low], values[seen].clip(low), [high]])
                axes.step(x, np.concatenate([[0], share[seen], [last]]), color=color, where="post", lw=2, label=cell)
            axes.axvline(threshold, color="#8a8f98", lw=1, ls=":")
            axes.set(xscale="log", xlim=(low, high), ylim=(0, 1.02), xlabel=label)
            axes.yaxis.set_major_formatter(PercentFormatter(1))
            if place == 1:
                axes.set_ylabel("objects within")

    return _svg(draw, (10, 3.8))


def success_by(rows: Sequence[JudgedT], colors: dict[str, str], key: Callable[[JudgedT], Any], label: str) -> str:
    """Success with its Wilson interval, by a property of the row."""

    def draw(figure: Figure) -> None:
        axes: Any = figure.add_subplot()
        groups = sorted({key(row) for row in rows})
        for number, (cell, color) in enumerate(colors.items()):
            offset = 0.12 * (number - (len(colors) - 1) / 2)
            for place, group in enumerate(groups):
                outcomes = [row.success_sym for row in rows if row.cell == cell and key(row) == group]
                if not outcomes:
                    continue
                low, high = wilson_interval(sum(outcomes), len(outcomes))
                axes.plot([place + offset] * 2, [low, high], color=color, lw=1.5, alpha=0.6)
                axes.plot(place + offset, np.mean(outcomes), "o", color=color, ms=5)
        axes.set_xticks(range(len(groups)), [str(group) for group in groups])
        axes.set(ylim=(-0.02, 1.02), xlabel=label, ylabel="objects right")
        axes.yaxis.set_major_formatter(PercentFormatter(1))

    return _svg(draw, (5, 3.6))


def confidence_curves(rows: Sequence[Row], colors: dict[str, str]) -> str:
    """Wrong answers against coverage, and right answers against stated confidence; empty where no cell states any."""
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
        reliability.plot([0, 1], [0, 1], color="#8a8f98", lw=1, ls=":")
        risk.set(xlabel="objects answered, most confident first", ylabel="wrong among them", ylim=(0, None))
        reliability.set(xlabel="stated confidence", ylabel="right", xlim=(0, 1.02), ylim=(0, 1.02))
        for axis in (risk.xaxis, risk.yaxis, reliability.yaxis):
            axis.set_major_formatter(PercentFormatter(1))

    return _svg(draw, (10, 3.4)) if stated else ""


def time_by_stage(summaries: Sequence[CellSummary]) -> str:
    """Median time per object, stacked by stage."""

    def draw(figure: Figure) -> None:
        axes: Any = figure.add_subplot()
        stages = list(dict.fromkeys(stage for summary in summaries for stage in summary.time_ms))
        left = np.zeros(len(summaries))
        for number, stage in enumerate(stages):
            width = np.array([summary.time_ms.get(stage, 0.0) for summary in summaries])
            axes.barh(range(len(summaries)), width, left=left, label=stage, color=PALETTE[number % len(PALETTE)])
            left += width
        axes.set_yticks(range(len(summaries)), [summary.cell for summary in summaries])
        axes.invert_yaxis()
        axes.set_xlabel("median ms per object (database's share included)")
        if stages:
            axes.legend(ncols=4, loc="upper center", bbox_to_anchor=(0.4, -0.28 - 0.1 / len(summaries)))

    return _svg(draw, (10, 1.6 + 0.42 * len(summaries)))


def _svg(draw: Callable[[Figure], None], size: tuple[float, float]) -> str:
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=size, layout="constrained")
        figure.patch.set_alpha(0)
        FigureCanvasSVG(figure)
        draw(figure)
        for axes in figure.axes:
            axes.patch.set_alpha(0)
        buffer = io.StringIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    return text[text.index("<svg") :]
