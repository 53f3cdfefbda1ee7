"""What every report page has: one look, success by kind of scene, what goes wrong, and how the run was made."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import yaml
from markupsafe import Markup

from toolkit.errors import ToolkitError
from toolkit.files import write_text
from toolkit.results.folder import META, PAGE, RESOLVED, ROWS, TABLE
from toolkit.results.report.plots import cell_colors, success_by
from toolkit.results.rows import Estimate, Judged, JudgedT, RowT, by_cell, read_rows_as

_MOST_FAILURES = 24
_MOST_OBJECTS = 10


def rows_to_report(run: Path, model: type[RowT]) -> list[RowT]:
    """The rows of a run.

    Raises:
        ToolkitError: there are none.
    """
    rows = read_rows_as(model, run / ROWS)
    if not rows:
        raise ToolkitError(f"'{run}' has no rows to report")
    return rows


def write_page(run: Path, template: str, table: str, rows: Sequence[JudgedT], cell: str, **own: Any) -> Path:
    """Write run/report.html, self-contained, and its table beside it.

    Args:
        run: the run's folder; its settings and meta.json stand at the end of the page.
        template: name of one that extends page.html.j2.
        table: Markdown of summary.md.
        rows: of the whole run.
        cell: the one whose hardest objects are shown.
        own: what the template needs besides; `headline` for one.
    """
    colors = cell_colors(list(by_cell(rows)))
    sizes = Counter((row.cell, row.scene_id) for row in rows)
    settings = read_if_there(run / RESOLVED)
    page = _template(template, colors).render(
        title=(yaml.safe_load(settings) or {}).get("experiment", run.name),
        colors=colors,
        by_count=success_by(rows, colors, lambda row: sizes[row.cell, row.scene_id], "objects in the scene"),
        by_symmetry=success_by(rows, colors, lambda row: row.symmetry, "symmetry of the object"),
        hardest=_hardest(by_cell(rows)[cell]),
        failures=failures(rows),
        settings=settings,
        meta=json.loads(read_if_there(run / META) or "{}"),
        **own,
    )
    write_text(run / PAGE, page)
    write_text(run / TABLE, table)
    return run / PAGE


def failures(rows: Sequence[Judged]) -> list[tuple[str, str, str, int]]:
    """Cell, stage, reason (numbers left out, so that like ones are counted together) and count; most frequent first."""
    counts = Counter((row.cell, row.stage or "pose", _general(row.reason)) for row in rows if not row.success_sym)
    return [(*key, count) for key, count in counts.most_common(_MOST_FAILURES)]


def read_if_there(path: Path) -> str:
    """A file's text, empty where there is no such file."""
    return path.read_text() if path.exists() else ""


def _template(name: str, colors: dict[str, str]) -> jinja2.Template:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("toolkit.results.report", "."), autoescape=True, undefined=jinja2.StrictUndefined
    )

    def dotted(cell: str) -> Markup:
        return Markup('<span class="dot" style="background:{}"></span>{}').format(colors[cell], cell)

    environment.filters |= {"dotted": dotted, "figure": _figure, "number": _number, "share": _share}
    return environment.get_template(name)


def _figure(estimate: Estimate | None) -> Markup | str:
    if estimate is None:
        return "–"
    low, high = estimate.interval
    return Markup(f"{_number(estimate.value)} <small>{_number(low)} – {_number(high)}</small>")


def _share(estimate: Estimate) -> Markup:
    low, high = estimate.interval
    return Markup(f"{estimate.value:.1%} <small>{low:.0%} – {high:.0%}</small>")


def _number(value: float, digits: int = 2) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "∞"


def _general(reason: str | None) -> str:
    return re.sub(r"\d+(\.\d+)?", "N", reason) if reason else "the pose is off by more than 5° or 2 cm"


def _hardest(rows: Sequence[JudgedT]) -> list[tuple[str, int, int, str]]:
    """The objects a cell gets wrong most often: name, right, seen, median rotation error."""
    by_name: dict[str, list[JudgedT]] = {}
    for row in rows:
        by_name.setdefault(row.object_name, []).append(row)
    ranked = sorted(by_name.items(), key=lambda item: (np.mean([row.success_sym for row in item[1]]), item[0]))
    return [
        (name, sum(row.success_sym for row in own), len(own), _median_rotation(own))
        for name, own in ranked[:_MOST_OBJECTS]
        if not all(row.success_sym for row in own)
    ]


def _median_rotation(rows: Sequence[Judged]) -> str:
    values = [row.rotation_error_deg_sym for row in rows if row.rotation_error_deg_sym is not None]
    return f"{np.median(values):.1f}°" if values else "no pose"
