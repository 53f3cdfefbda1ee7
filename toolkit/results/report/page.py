"""What every report page has: one look, success by kind of scene, what goes wrong, and how the run was made."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup, escape

from toolkit.errors import ToolkitError
from toolkit.files import write_text
from toolkit.results.about import About
from toolkit.results.comparisons import compare_cells, comparison_table, shown_in_words
from toolkit.results.figure_table import Column, Figure, FigureTable, Line
from toolkit.results.folder import FIGURES, PAGE, ROWS, TABLE, TABLES
from toolkit.results.report.cases import read_cases
from toolkit.results.report.plots import Plot, cell_colors, success_by
from toolkit.results.rows import Judged, JudgedT, RowT, by_cell, read_rows_as

_MOST_FAILURES = 24
_MOST_OBJECTS = 10

_IN_SUMMARY = ("results", "comparisons", "failures")
"""The tables that stand in summary.md too, in this order."""


def rows_to_report(run: Path, model: type[RowT]) -> list[RowT]:
    """The rows of a run.

    Raises:
        ToolkitError: there are none.
    """
    rows = read_rows_as(model, run / ROWS)
    if not rows:
        raise ToolkitError(f"'{run}' has no rows to report")
    return rows


def write_page(
    run: Path,
    template: str,
    rows: Sequence[JudgedT],
    best: str,
    tables: Mapping[str, FigureTable],
    plots: Sequence[Plot] = (),
    **own: Any,
) -> Path:
    """Write run/report.html, self-contained; beside it every table as CSV and LaTeX and every plot as SVG and PDF.

    The page shows the pictures that lie in the run's folder.

    Args:
        run: the run's folder; its settings and meta.json stand at the end of the page.
        template: name of one that extends page.html.j2.
        rows: of the whole run.
        best: the cell that is set off in tables, and whose hardest objects are shown.
        tables: the page's own, by the names of their files; `results` for one.
        plots: the page's own.
        own: what the template needs besides; `headline` for one.
    """
    about = About.read(run)
    cells = by_cell(rows)
    colors = cell_colors(list(cells))
    sizes = Counter((row.cell, row.scene_id) for row in rows)
    comparisons = compare_cells(rows, about.reference)
    tables = {
        **tables,
        "comparisons": comparison_table(comparisons),
        "failures": _failure_table(rows),
        "hardest": _hardest_table(best, cells[best]),
        "cells": _cell_table(about.own),
    }
    plots = [
        *plots,
        success_by("count", rows, colors, lambda row: sizes[row.cell, row.scene_id], "objects in the scene"),
        success_by("symmetry", rows, colors, lambda row: row.symmetry, "symmetry of the object"),
    ]
    page = _template(template, colors).render(
        about=about,
        best=best,
        shown=shown_in_words(comparisons),
        tables=tables,
        plots={plot.name: Markup(plot.svg()) for plot in plots},
        cases=read_cases(run),
        **own,
    )
    write_text(run / PAGE, page)
    write_text(run / TABLE, "\n".join(tables[name].markdown() for name in _IN_SUMMARY if tables[name].lines))
    for folder in (TABLES, FIGURES):
        (run / folder).mkdir(exist_ok=True)
    for name, table in tables.items():
        if table.lines:
            write_text(run / TABLES / f"{name}.csv", table.csv())
            write_text(run / TABLES / f"{name}.tex", table.latex(about.command))
    for plot in plots:
        plot.write(run / FIGURES)
    return run / PAGE


def _failure_table(rows: Sequence[Judged]) -> FigureTable:
    """What goes wrong, most frequent first; figures in reasons are left out, so that like ones are counted together."""
    counts = Counter((row.cell, row.stage or "pose", _general(row.reason)) for row in rows if not row.success_sym)
    columns = (Column("cell"), Column("stage", kind="words"), Column("reason", kind="words"), Column("objects"))
    lines = tuple(Line((*key, Figure(count, form="d"))) for key, count in counts.most_common(_MOST_FAILURES))
    return FigureTable("What kept objects from being right", columns, lines)


def _hardest_table(cell: str, rows: Sequence[JudgedT]) -> FigureTable:
    """The objects a cell gets wrong most often."""
    by_name: dict[str, list[JudgedT]] = {}
    for row in rows:
        by_name.setdefault(row.object_name, []).append(row)
    ranked = sorted(by_name.items(), key=lambda item: (np.mean([row.success_sym for row in item[1]]), item[0]))
    lines = tuple(
        Line((name, *_counts(own), *_medians(own)))
        for name, own in ranked[:_MOST_OBJECTS]
        if not all(row.success_sym for row in own)
    )
    columns = tuple(map(Column, ("object", "right", "seen", "median rotation, deg", "median translation, cm")))
    return FigureTable(f"The hardest objects of '{cell}'", columns, lines)


def _cell_table(own: Mapping[str, str]) -> FigureTable:
    columns = (Column("cell"), Column("what sets it apart", kind="words"))
    return FigureTable("The cells", columns, tuple(Line((cell, words)) for cell, words in own.items()))


def _template(name: str, colors: dict[str, str]) -> jinja2.Template:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("toolkit.results.report", "."), autoescape=True, undefined=jinja2.StrictUndefined
    )

    def cell(content: str | Figure) -> Markup:
        if isinstance(content, Figure):
            return Markup("{}<small>{}</small>" if content.bounds else "{}").format(content.text, content.bounds)
        if content not in colors:
            return escape(content)
        return Markup('<span class="cell"><i style="background:{}"></i>{}</span>').format(colors[content], content)

    environment.filters["cell"] = cell
    environment.globals["colors"] = colors  # pyright: ignore[reportArgumentType]
    return environment.get_template(name)


def _general(reason: str | None) -> str:
    if not reason:
        return "the pose is off by more than 5° or 2 cm"
    said_once = re.sub(r" \([^()]*\d[^()]*\)", "", reason)
    return re.sub(r"\d+(\.\d+)?", "N", said_once)


def _counts(rows: Sequence[Judged]) -> tuple[Figure, Figure]:
    """How many are right, and how many there are."""
    return Figure(sum(row.success_sym for row in rows), form="d"), Figure(len(rows), form="d")


def _medians(rows: Sequence[Judged]) -> tuple[str | Figure, ...]:
    """Median errors of those with a pose: deg and cm."""
    kinds = [row.rotation_error_deg_sym for row in rows], [row.translation_error_cm_sym for row in rows]
    known = [[error for error in errors if error is not None] for errors in kinds]
    return tuple(Figure(float(np.median(errors)), form=".1f") if errors else "no pose" for errors in known)
