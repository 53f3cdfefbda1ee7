"""Run folders: runs/<name>/<time>/, what is written before the first row, and how a run is taken up again."""

from __future__ import annotations

import platform
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import yaml

from toolkit import __version__
from toolkit.digests import digest, package_digest
from toolkit.errors import ToolkitError
from toolkit.files import write_json, write_text, writing
from toolkit.harness.cache import library_versions
from toolkit.harness.experiment import Cell
from toolkit.parallel import cores
from toolkit.results.folder import META, RESOLVED, ROWS, SUMMARY
from toolkit.results.rows import ObjectRow, RowT, read_rows_as, write_rows
from toolkit.settings import read_settings


@dataclass(frozen=True)
class Shard:
    """Every `count`-th scene from the `number`-th, counted from 1: a part of an experiment that runs on its own."""

    number: int
    count: int

    @staticmethod
    def parse(text: str) -> Shard:
        """Read `2/3`.

        Raises:
            ToolkitError: it is not a part of a whole.
        """
        number, _, count = text.partition("/")
        if not (number.isdecimal() and count.isdecimal() and 1 <= int(number) <= int(count)):
            raise ToolkitError(f"--shard takes I/N, such as 2/3 for the second of three parts, got '{text}'")
        return Shard(int(number), int(count))

    def holds(self, scene_id: int) -> bool:
        """Say whether a scene is in this part."""
        return scene_id % self.count == self.number - 1

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"


WHOLE = Shard(1, 1)


@dataclass(frozen=True)
class RunOptions:
    """How a run is carried out. No field changes a row.

    Attributes:
        out: the run's folder, or None for runs/<name>/<time>/.
        workers: processes on this machine.
        backend: what starts them: loky, dask or ray.
        address: the dask or ray cluster to work on instead.
        shard: the part of the scenes to run.
        resume: go on with the finished rows of `out`, or of the newest run with the same settings.
        fresh: start `out` again even where it holds a run.
        use_cache: False computes everything anew and keeps nothing.
        plugin_files: plugin files that are not installed; workers load them too.
        log: names of the hooks that follow the run.
    """

    out: Path | None = None
    workers: int = 1
    backend: str = "loky"
    address: str | None = None
    shard: Shard = WHOLE
    resume: bool = False
    fresh: bool = False
    use_cache: bool = True
    plugin_files: tuple[Path, ...] = ()
    log: tuple[str, ...] = ()


def resolve(name: str, cells: Sequence[Mapping[str, Any]], shard: Shard = WHOLE) -> dict[str, Any]:
    """What experiment.resolved.yaml says: all that decides the rows of an experiment, or of one shard of it."""
    resolved: dict[str, Any] = {"experiment": name, "cells": [dict(cell) for cell in cells]}
    return resolved if shard == WHOLE else {**resolved, "shard": str(shard)}


def run_place(name: str, out: Path | None) -> Path:
    """Where a run of an experiment lies: `out`, or below runs/<name>."""
    return out or Path("runs") / name


def open_run(name: str, resolved: Mapping[str, Any], out: Path | None, *, resume: bool, fresh: bool) -> Path:
    """Make the run's folder, or find the one to go on with.

    Args:
        name: the experiment's name.
        resolved: everything that decides the rows; a run is resumed only where it is the same.
        out: the folder, or None for runs/<name>/<time>/.
        resume: go on in `out`, or in the newest unfinished or finished run of the same settings.
        fresh: empty `out` first where it holds a run.

    Raises:
        ToolkitError: the folder holds a run and neither was asked for; there is nothing to resume; the settings differ.
    """
    if resume:
        return _resumable(name, resolved, out)
    run = out or _new_folder(run_place(name, out))
    if (run / ROWS).exists() and not fresh:
        raise ToolkitError(f"'{run}' already holds a run; add --resume to go on with it or --fresh to start again")
    if fresh and (run / RESOLVED).exists():
        shutil.rmtree(run)
    run.mkdir(parents=True, exist_ok=True)
    write_resolved(run, resolved)
    return run


def write_resolved(run: Path, resolved: Mapping[str, Any]) -> None:
    """Write experiment.resolved.yaml."""
    write_text(run / RESOLVED, yaml.safe_dump(dict(resolved), sort_keys=False))


def _new_folder(parent: Path) -> Path:
    """A folder named by the time; runs that begin in the same second get one each."""
    now = datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%S")
    folder, number = parent / now, 1
    while True:
        try:
            folder.mkdir(parents=True)
            return folder
        except FileExistsError:
            number += 1
            folder = parent / f"{now}-{number}"


def _resumable(name: str, resolved: Mapping[str, Any], out: Path | None) -> Path:
    place = run_place(name, out)
    candidates = [out] if out else sorted(place.glob("*"), reverse=True)
    for run in candidates:
        if (run / RESOLVED).exists() and digest(read_resolved(run)) == digest(resolved):
            (run / SUMMARY).unlink(missing_ok=True)
            return run
    raise ToolkitError(f"'{place}' holds no run with these settings to resume; leave --resume out to start one")


def finished(run: Path, model: type[ObjectRow]) -> set[tuple[str, int]]:
    """(cell, scene) pairs that already have all their rows, which are of type `model`.

    The last pair in the file may lack rows when the run was killed while they were written, so it is cut off and done
    again, as is a torn last line.
    """
    rows = read_rows_as(model, run / ROWS) if (run / ROWS).exists() else []
    whole = [row for row in rows if (row.cell, row.scene_id) != (rows[-1].cell, rows[-1].scene_id)]
    write_rows(run / ROWS, whole)
    return {(row.cell, row.scene_id) for row in whole}


def in_order(rows: Sequence[RowT], cells: Sequence[str]) -> list[RowT]:
    """The rows as they stand in a finished run: by cell, scene and object."""
    order = {cell: i for i, cell in enumerate(cells)}
    return sorted(rows, key=lambda row: (order[row.cell], row.scene_id, row.object))


def read_resolved(run: Path) -> dict[str, Any]:
    """What `resolve` gave, as the run wrote it down; empty where it wrote nothing.

    Raises:
        ToolkitError: the file cannot be read.
    """
    path = run / RESOLVED
    return read_settings(path, "settings of a run", "experiment and cells") if path.exists() else {}


def read_cells(run: Path) -> list[Cell]:
    """The cells of a run, as it wrote them down.

    Raises:
        ToolkitError: the run wrote none down (`toolkit evaluate` does not), or not as this version does.
    """
    if not (run / RESOLVED).is_file():
        raise ToolkitError(f"'{run}' has no {RESOLVED}; only runs of `toolkit ablate` can be made again")
    try:
        return [Cell.read(cell) for cell in read_resolved(run)["cells"]]
    except (KeyError, TypeError) as error:
        raise ToolkitError(f"'{run / RESOLVED}' is not of this version: {error!r}") from error


def require_run(folder: Path) -> None:
    """Raise ToolkitError where a folder is no run."""
    if not (folder / ROWS).is_file():
        raise ToolkitError(f"'{folder}' is not a run folder: it has no {ROWS}")


def write_meta(
    run: Path, about: Mapping[str, str], weights: Mapping[str, str], datasets: Sequence[Mapping[str, Any]]
) -> None:
    """Write meta.json: commit, versions, device, and what a run knows.

    Args:
        run: its folder.
        about: its title, and its description and reference where it has them.
        weights: digests of the weights by name.
        datasets: how every dataset was made.
    """
    write_json(
        run / META,
        {
            "experiment": dict(about),
            "toolkit": __version__,
            "source": package_digest(),
            **_commit(),
            "command": sys.argv,
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "python": platform.python_version(),
            "platform": platform.platform(),
            "processor": _processor(),
            "cores": cores(),
            "versions": library_versions(),
            "weights": dict(weights),
            "datasets": [dict(dataset) for dataset in datasets],
        },
    )


def writable(what: str) -> AbstractContextManager[None]:
    """`writing` in a run, whose finished rows are on disk already."""
    return writing(what, "; finished rows are kept")


def _commit() -> dict[str, Any]:
    def git(*arguments: str) -> str | None:
        folder = Path(__file__).parent
        try:
            done = subprocess.run(["git", "-C", str(folder), *arguments], capture_output=True, text=True, check=True)
        except (OSError, subprocess.CalledProcessError):
            return None
        return done.stdout.strip()

    status = git("status", "--porcelain")
    return {"commit": git("rev-parse", "HEAD"), "dirty": None if status is None else bool(status)}


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
