"""A table of figures in every form that it is read in: on a terminal, as Markdown, CSV and LaTeX; pages make HTML."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from toolkit.results.stats import Interval

_LONG = 40
"""Characters: LaTeX sets more than that in several lines, and a terminal breaks a longer word."""

_LATEX = str.maketrans(
    {
        **{character: f"\\{character}" for character in "&%$#_{}"},
        "\\": r"\textbackslash{}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "<": "$<$",
        ">": "$>$",
        "∞": r"$\infty$",
        "±": r"$\pm$",
        "°": r"$^\circ$",
        "–": "--",
    }
)


@dataclass(frozen=True)
class Figure:
    """A number, and how it is shown.

    Attributes:
        value: in the unit that is shown.
        interval: of the value, None where none is known.
        form: format specification; empty for three figures, or fewer below 1.
        unit: stands directly behind the value.
    """

    value: float
    interval: Interval | None = None
    form: str = ""
    unit: str = ""

    @property
    def text(self) -> str:
        """The value without its interval."""
        return self._show(self.value) + self.unit

    @property
    def bounds(self) -> str:
        """The interval, `low, high`; empty where none is known."""
        return "" if self.interval is None else ", ".join(map(self._show, self.interval))

    def __str__(self) -> str:
        return f"{self.text} [{self.bounds}]" if self.bounds else self.text

    def _show(self, value: float) -> str:
        if not np.isfinite(value):
            return ("-" if value < 0 else "+" * self.form.startswith("+")) + "∞"
        return format(value, self.form or f".{2 if value < 10 else 1 if value < 100 else 0}f")


@dataclass(frozen=True)
class Column:
    """What stands under a heading.

    Attributes:
        heading: in words.
        least_width: from how many columns of a terminal on it is shown there; all other forms have it always.
        kind: words may be wrapped, numbers stand to the right and in one piece.
        name: the heading in a CSV file, where that of a neighbour would have to be read for it.
    """

    heading: str
    least_width: int = 0
    kind: Literal["number", "words"] = "number"
    name: str = ""


@dataclass(frozen=True)
class Line:
    """The cells of a line; a line of the paper's may have fewer than there are columns."""

    cells: tuple[str | Figure, ...]
    is_paper: bool = False


@dataclass(frozen=True)
class FigureTable:
    """Lines under headings.

    Attributes:
        title: what the figures are.
        columns: the first names the line, in words.
        lines: those of the paper stand under the ones they belong to.
    """

    title: str
    columns: tuple[Column, ...]
    lines: tuple[Line, ...]

    def print(self, console: Console) -> None:
        """Print the columns that the console is wide enough for."""
        table = Table(title=self.title, title_justify="left", box=box.SIMPLE_HEAD, padding=0, pad_edge=False)
        shown = [i for i, column in enumerate(self.columns) if console.width >= column.least_width]
        for i in shown:
            column = self.columns[i]
            in_words = i == 0 or column.kind == "words"
            words = [word for cells in self._padded() for word in str(cells[i]).split()]
            longest = max(map(len, words), default=0)
            table.add_column(column.heading, overflow="fold", no_wrap=not in_words, min_width=min(longest, _LONG))
        for line, cells in zip(self.lines, self._padded(), strict=True):
            first, *others = (str(cells[i]) for i in shown)
            table.add_row("  " * line.is_paper + first, *others, style="dim" * line.is_paper)
        console.print(table, markup=False)

    def markdown(self) -> str:
        """The whole table under its title; the paper's figures in italics."""
        rows = [[column.heading for column in self.columns], ["---"] * len(self.columns)]
        for line, cells in zip(self.lines, self._padded(), strict=True):
            rows.append([f"*{cell}*" if cell and line.is_paper else str(cell) for cell in cells])
        return f"{self.title}\n\n" + "".join(f"| {' | '.join(row)} |\n" for row in rows)

    def csv(self) -> str:
        """The whole table as numbers: a figure's interval has two columns of its own."""
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        padded = self._padded()
        spread = [any(isinstance(cell, Figure) and cell.interval for cell in own) for own in zip(*padded, strict=True)]
        names = [column.name or column.heading for column in self.columns]
        headings = (
            [name, f"{name} low", f"{name} high"] if s else [name] for name, s in zip(names, spread, strict=True)
        )
        writer.writerow([name for group in headings for name in group])
        for row in padded:
            groups = (_numbers(cell, s) for cell, s in zip(row, spread, strict=True))
            writer.writerow([number for group in groups for number in group])
        return buffer.getvalue()

    def latex(self, command: str = "") -> str:
        r"""The whole table as a tabular of the package booktabs, to stand in a `table`; intervals in small print.

        Args:
            command: what made the run, to stand in a comment; empty where that is not known.
        """
        layout = "".join(map(self._latex_column, range(len(self.columns))))
        head = [column.heading.translate(_LATEX) for column in self.columns]
        body: list[str] = []
        for line, cells in zip(self.lines, self._padded(), strict=True):
            shown = [rf"\textit{{{_in_latex(cell)}}}" if cell and line.is_paper else _in_latex(cell) for cell in cells]
            body.append(" & ".join(shown) + r" \\")
        rows = [rf"\begin{{tabular}}{{{layout}}}", r"\toprule", " & ".join(head) + r" \\", r"\midrule", *body]
        ends = [r"\bottomrule", r"\end{tabular}"]
        needed = r"% \usepackage{booktabs}; where it is too wide, graphicx and \resizebox{\linewidth}{!}{\input{FILE}}"
        made = [f"% {' '.join(command.split())}"] if command else []
        return "\n".join([f"% {self.title}", *made, needed, *rows, *ends]) + "\n"

    def _latex_column(self, i: int) -> str:
        if i and self.columns[i].kind == "number":
            return "r"
        return "p{5cm}" if max((len(str(cells[i])) for cells in self._padded()), default=0) > _LONG else "l"

    def _padded(self) -> list[list[str | Figure]]:
        """The cells of every line, as many as there are columns."""
        return [[*line.cells, *[""] * (len(self.columns) - len(line.cells))] for line in self.lines]


def _numbers(cell: str | Figure, spread: bool) -> Sequence[object]:
    if isinstance(cell, str):
        return [cell, "", ""] if spread else [cell]
    return [cell.value, *(cell.interval or ("", ""))] if spread else [cell.value]


def _in_latex(cell: str | Figure) -> str:
    if isinstance(cell, str):
        return cell.translate(_LATEX)
    small = rf" {{\scriptsize [{_number_in_latex(cell.bounds)}]}}" if cell.bounds else ""
    return _number_in_latex(cell.text) + small


def _number_in_latex(text: str) -> str:
    """A hyphen before a number is a minus."""
    return text.translate(_LATEX).replace("-", "$-$")
