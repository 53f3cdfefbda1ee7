"""`toolkit view`: one scene of a run, or one capture, estimated anew and written as a recording."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich import box
from rich.table import Table

from toolkit.data.bop import load_capture
from toolkit.data.source import open_capture
from toolkit.errors import ToolkitError, suggest
from toolkit.harness.ablate import Ablation
from toolkit.harness.cache import Cache
from toolkit.harness.drive import kind_of
from toolkit.harness.experiment import Cell
from toolkit.harness.runs import read_cells
from toolkit.harness.worker import make_runner, require_ready
from toolkit.paths import cache_root
from toolkit.pictures.recording import load_rerun, off, record_scene
from toolkit.results.folder import ROWS
from toolkit.results.rows import Row, best_cell, read_rows, worst_rows
from toolkit.types import Capture


def is_capture(folder: Path) -> bool:
    """Say whether a folder is laid out as a capture."""
    return (folder / "current").is_dir() and (folder / "goal").is_dir()


def view_capture(folder: Path, cell: Cell, out: Path) -> Path:
    """Estimate one capture folder and write its recording.

    Returns:
        `out`.

    Raises:
        ToolkitError: rerun is not installed, the capture cannot be read, a stage lacks something or breaks, or `out`
            cannot be written.
    """
    load_rerun()
    capture = load_capture(folder)
    _record(out, f"capture {capture.name}", capture, cell, None)
    return out


def view_scene(run: Path, scene: int, cell: str | None = None, out: Path | None = None) -> Path:
    """Write the recording of one scene of a run, by what is installed now.

    Args:
        run: the run's folder.
        scene: the scene's id.
        cell: the cell's name; the one with most objects right when left out.
        out: the .rrd file; RUN/recordings/<scene>.rrd when left out.

    Returns:
        The file.

    Raises:
        ToolkitError: rerun is not installed; there is no such run, cell or scene; or as `view_capture`.
    """
    load_rerun()
    rows = rows_of(run)
    name = _cell_name(run, rows, cell)
    chosen = next(found for found in read_cells(run) if found.name == name)
    scenes = sorted({row.scene_id for row in rows if row.cell == name})
    if scene not in scenes:
        raise ToolkitError(f"run '{run}' has no scene {scene}; it has {len(scenes)}, from {scenes[0]} to {scenes[-1]}")
    path = out or run / "recordings" / f"{scene:06d}.rrd"
    capture = load_capture(open_capture(chosen.dataset, cache_root(), scene))
    _record(path, f"scene {scene}, {name}", capture, chosen, Cache(cache_root() / "stages"))
    return path


def rows_of(run: Path) -> list[Row]:
    """The rows of a run whose scenes can be viewed.

    Raises:
        ToolkitError: the folder is no run of `toolkit ablate`.
    """
    if not (run / ROWS).is_file():
        raise ToolkitError(
            f"'{run}' is neither a run folder (with {ROWS}) nor a capture folder (with current/ and goal/)"
        )
    if not isinstance(kind_of(run), Ablation):
        raise ToolkitError(f"'{run}' rearranged its scenes; `toolkit rearrange --film` records one while it is moved")
    rows = read_rows(run / ROWS)
    if not rows:
        raise ToolkitError(f"run '{run}' has no rows yet")
    return rows


def worst_table(run: Path, cell: str | None = None, count: int = 20) -> Table:
    """The worst objects of a run for the terminal, of one cell, worst first; the arguments are those of `view_scene`.

    Raises:
        ToolkitError: there is no such run or cell.
    """
    rows = rows_of(run)
    name = _cell_name(run, rows, cell)
    of_cell = [row for row in rows if row.cell == name]
    wrong = sum(not row.success_sym for row in of_cell)
    title = f"{wrong} of {len(of_cell)} objects of {name} are wrong (5 deg, 2 cm)"
    columns = ("scene", "object", "status", "off", "confidence", "ambiguity", "why not")
    table = Table(*columns, title=title, title_justify="left", box=box.SIMPLE_HEAD)
    for row in worst_rows(of_cell, count):
        table.add_row(
            str(row.scene_id),
            row.object_name,
            row.status,
            off(row),
            "" if row.confidence is None else f"{row.confidence:.2f}",
            row.ambiguity or "",
            f"{row.stage}: {row.reason}" if row.reason else "",
        )
    return table


def open_viewer(path: Path) -> bool:
    """Open a recording in Rerun's viewer, which goes on after this process; False where there is no display."""
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    subprocess.Popen(
        [sys.executable, "-m", "rerun", str(path)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    return True


def _cell_name(run: Path, rows: Sequence[Row], cell: str | None) -> str:
    if cell is None:
        return best_cell(rows)
    names = list(dict.fromkeys(row.cell for row in rows))
    if cell not in names:
        raise ToolkitError(f"run '{run}' has no cell '{cell}'{suggest(cell, names)}")
    return cell


def _record(path: Path, name: str, capture: Capture, cell: Cell, cache: Cache | None) -> None:
    require_ready([cell])
    pipeline = make_runner(cell, cache).pipeline
    try:
        scene = pipeline.scene(pipeline.build_database(capture.current))
        estimates = scene.estimate(capture.goal)
        goal = pipeline.stages.registration.locate(capture.goal, scene.database.frames)
    except ToolkitError:
        raise
    except Exception as error:
        raise ToolkitError(f"{name}: the pipeline breaks with {type(error).__name__}: {error}") from error
    record_scene(path, name, replace(capture, goal=goal), scene.database, scene.clouds(), estimates)
