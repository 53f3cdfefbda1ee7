"""Shards of one experiment -> one run."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from toolkit.errors import ToolkitError
from toolkit.files import write_json
from toolkit.harness.drive import kind_of
from toolkit.harness.kinds import RunKind
from toolkit.harness.runs import Shard, in_order, open_run, read_resolved, require_run, writable
from toolkit.results.about import About
from toolkit.results.folder import META, PICTURES, RESOLVED, ROWS, SUMMARY
from toolkit.results.rows import read_rows_as, summary_lines, write_rows, write_summary

_SAME = {"source": "code", "versions": "library versions", "weights": "weights"}
"""Entries of meta.json in which shards must agree, or their rows are not of one experiment."""


def merge_shards(runs: Sequence[Path], out: Path) -> Path:
    """Write the run that the shards of an experiment make up: all of it but the report.

    Args:
        runs: the folders of all shards, in any order.
        out: the new run's folder.

    Raises:
        ToolkitError: a folder is not the finished run of a shard; the runs differ in more than the shard; a shard is
            missing or given twice; a shard holds rows of another; or `out` holds a run.
    """
    if (out / ROWS).exists():
        raise ToolkitError(f"'{out}' already holds a run; name a new folder with --out")
    for run in runs:
        _require_finished(run)
    settings: list[dict[str, Any]] = [read_resolved(run) for run in runs]
    metas: list[dict[str, Any]] = [json.loads((run / META).read_text()) for run in runs]
    shards = _complete([own.pop("shard", None) for own in settings], runs)
    for run, own, meta in zip(runs, settings, metas, strict=True):
        _require_same(runs[0], settings[0], metas[0], run, own, meta)
    with writable(f"'{out}'"):
        open_run(settings[0]["experiment"], settings[0], out, resume=False, fresh=False)
        made = [dataset for meta in metas for dataset in meta["datasets"]]
        unique = [dataset for i, dataset in enumerate(made) if dataset not in made[:i]]
        write_json(out / META, {**metas[0], "datasets": unique, "shards": metas})
        for run in runs:
            if (run / PICTURES).is_dir():
                shutil.copytree(run / PICTURES, out / PICTURES, dirs_exist_ok=True)
        cells = [cell["cell"] for cell in settings[0]["cells"]]
        _write_rows(out, shards, cells, kind_of(out))
    return out


def _require_finished(run: Path) -> None:
    require_run(run)
    if not all((run / name).is_file() for name in (RESOLVED, META, SUMMARY)):
        raise ToolkitError(f"'{run}' is not finished; run its command again with --resume --out '{run}'")


def _complete(given: Sequence[str | None], runs: Sequence[Path]) -> dict[Shard, Path]:
    """The runs by shard, all of them, each once."""
    found: dict[Shard, Path] = {}
    for text, run in zip(given, runs, strict=True):
        if text is None:
            raise ToolkitError(f"'{run}' holds all scenes already; only runs with --shard are merged")
        shard = Shard.parse(text)
        if shard in found:
            raise ToolkitError(f"'{found[shard]}' and '{run}' are both shard {shard}; give every shard once")
        found[shard] = run
    count = next(iter(found)).count
    if odd := next((shard for shard in found if shard.count != count), None):
        raise ToolkitError(f"'{found[odd]}' is shard {odd}, but '{runs[0]}' is one of {count}")
    if missing := [str(shard) for i in range(count) if (shard := Shard(i + 1, count)) not in found]:
        raise ToolkitError(f"shard {' and '.join(missing)} is missing; run it and name its folder too")
    return found


def _require_same(
    first: Path,
    settings: Mapping[str, Any],
    meta: Mapping[str, Any],
    run: Path,
    own: Mapping[str, Any],
    own_meta: Mapping[str, Any],
) -> None:
    if own != settings:
        raise ToolkitError(
            f"'{run}' and '{first}' differ in {_difference(settings, own)}; only shards of one experiment merge"
        )
    for key, name in _SAME.items():
        if own_meta.get(key) != meta.get(key):
            raise ToolkitError(f"'{run}' and '{first}' were made with other {name}; run one of them again")


def _difference(one: Any, other: Any, path: str = "") -> str:
    """The first place at which two nested values differ, and what they say there."""
    if isinstance(one, dict) and isinstance(other, dict):
        pairs = [(str(key), one.get(key), other.get(key)) for key in (*one, *(k for k in other if k not in one))]
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        pairs = [(str(i), a, b) for i, (a, b) in enumerate(zip(one, other, strict=True))]
    else:
        return f"{path.removeprefix('.')} ({other!r} and {one!r})"
    key, a, b = next((key, a, b) for key, a, b in pairs if a != b)
    return _difference(a, b, f"{path}.{key}")


def _write_rows(out: Path, shards: Mapping[Shard, Path], cells: Sequence[str], kind: RunKind[Any, Any]) -> None:
    """Write the rows of all shards in the order of a run in one piece, and their summary."""
    rows: list[Any] = []
    for shard, run in shards.items():
        own = read_rows_as(kind.row, run / ROWS)
        if stray := next((row for row in own if not shard.holds(row.scene_id)), None):
            raise ToolkitError(f"'{run}' is shard {shard}, but holds rows of scene {stray.scene_id}")
        rows += own
    rows = in_order(rows, cells)
    write_rows(out / ROWS, rows)
    write_summary(out / SUMMARY, summary_lines(kind.summarize(rows), kind.compare(rows, About.read(out).reference)))
