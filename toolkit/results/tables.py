"""A run's figures as a table, for a terminal and as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from toolkit.results.completion import CompletionSummary
from toolkit.results.paper_figures import paper_completion, paper_medians
from toolkit.results.rows import CellSummary, Estimate

_WIDE, _WIDEST = 110, 140


@dataclass(frozen=True)
class Column:
    """A heading, and from how many columns of a terminal on it is shown; Markdown shows all."""

    heading: str
    least_width: int = 0


@dataclass(frozen=True)
class Line:
    """The cells of a line; a line of the paper's may have fewer than there are columns."""

    cells: tuple[str, ...]
    is_paper: bool = False


@dataclass(frozen=True)
class FigureTable:
    """Lines under headings.

    Attributes:
        title: what the figures are.
        columns: the first names the cell.
        lines: one per cell, some with the paper's under them.
    """

    title: str
    columns: tuple[Column, ...]
    lines: tuple[Line, ...]

    def print(self, console: Console) -> None:
        """Print the columns that the console is wide enough for."""
        table = Table(title=self.title, title_justify="left", box=box.SIMPLE_HEAD, padding=0, pad_edge=False)
        shown = [i for i, column in enumerate(self.columns) if console.width >= column.least_width]
        for i in shown:
            table.add_column(self.columns[i].heading, overflow="fold", no_wrap=i > 0)
        for line in self.lines:
            cells = [line.cells[i] if i < len(line.cells) else "" for i in shown]
            table.add_row(*(["  " + cells[0], *cells[1:]] if line.is_paper else cells), style="dim" * line.is_paper)
        console.print(table)

    def markdown(self) -> str:
        """The whole table; the paper's figures in italics."""
        rows = [[column.heading for column in self.columns], ["---"] * len(self.columns)]
        for line in self.lines:
            cells = [*line.cells, *[""] * (len(self.columns) - len(line.cells))]
            rows.append([f"*{cell}*" if cell and line.is_paper else cell for cell in cells])
        return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def motion_table(summaries: Sequence[CellSummary]) -> FigureTable:
    """How well motions were estimated, with the paper's figures under the cells of its Table I.

    False alarms are shown where some objects are in the goal only.
    """
    lines: list[Line] = []
    one_sided = any(s.absent for s in summaries)
    for s in summaries:
        cells = (
            s.cell,
            _show(s.rotation_median_deg_sym),
            _number(s.rotation_p90_deg_sym),
            _show(s.translation_median_cm_sym),
            _number(s.translation_p90_cm_sym),
            _show_share(s.success_sym),
            _show_share(s.completion_sym),
            *([_show_share(s.false_alarms) if s.false_alarms else ""] if one_sided else []),
            str(s.objects),
            f"{s.matcher_calls:.1f}",
            f"{s.total_ms:.0f}",
        )
        lines.append(Line(cells))
        if paper := paper_medians(s.settings):
            rotation, translation = map(_number, paper)
            lines.append(Line(("paper, Table I", rotation, "", translation), is_paper=True))
    columns = (
        Column("cell"),
        Column("rotation, deg"),
        Column("p90", _WIDEST),
        Column("translation, cm"),
        Column("p90", _WIDEST),
        Column("5 deg 2 cm"),
        Column("scenes done", _WIDE),
        *([Column("false alarms", _WIDE)] if one_sided else []),
        Column("objects", _WIDE),
        Column("matcher calls", _WIDE),
        Column("ms / object", _WIDE),
    )
    return FigureTable("Motion of every object, symmetry-aware; median [95 % interval]", columns, tuple(lines))


def completion_table(summaries: Sequence[CompletionSummary]) -> FigureTable:
    """How often scenes were set right, with the paper's figures under the cells of its Table II; moves per object."""
    lines: list[Line] = []
    for s in summaries:
        cells = (
            s.cell,
            _show_share(s.completion_sym),
            _show_share(s.completion_sym_one_step),
            _show_share(s.success_sym),
            _show(s.moves_per_object),
            f"{s.buffer_moves_per_scene:.2f}",
            f"{s.rounds:.1f}",
            f"{s.perception_s:.1f}",
            f"{s.planning_ms:.0f}",
            f"{s.motion_s:.0f}",
        )
        lines.append(Line(cells))
        if (paper := paper_completion(s.settings)) is not None:
            lines.append(Line(("paper, Table II", f"{paper:.1%}"), is_paper=True))
    columns = (
        *map(Column, ("cell", "scenes done", "in one step", "objects right", "moves")),
        *(Column(heading, _WIDE) for heading in ("aside", "rounds", "see, s", "plan, ms", "move, s")),
    )
    title = "Scenes with every object within 2 cm and 5 deg, symmetry-aware; [95 % interval]"
    return FigureTable(title, columns, tuple(lines))


def _show(estimate: Estimate) -> str:
    low, high = map(_number, estimate.interval)
    return f"{_number(estimate.value)} [{low}, {high}]"


def _number(value: float) -> str:
    """Three figures, or fewer below 1."""
    if not np.isfinite(value):
        return "∞"
    return f"{value:.{2 if value < 10 else 1 if value < 100 else 0}f}"


def _show_share(estimate: Estimate) -> str:
    low, high = (100 * bound for bound in estimate.interval)
    return f"{estimate.value:.0%} [{low:.0f}, {high:.0f}]"
