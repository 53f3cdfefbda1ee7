"""Rows (one per object and cell), their files, and the summary of a cell."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from toolkit.errors import ToolkitError
from toolkit.files import write_text
from toolkit.results.stats import Interval, PairedDifference, bootstrap_interval, wilson_interval
from toolkit.types import Ambiguity, Float


class ObjectRow(BaseModel):
    """What every row says, whatever the run: which true object it is of, in which cell.

    `dataset` is the digest of the dataset's settings: rows of one dataset and `scene_id` are of the same scene.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    cell: str
    scene_id: int
    settings: dict[str, Any]
    dataset: str = ""
    scene: str
    object: int
    object_name: str
    symmetry: Literal["none", "discrete", "continuous"]


RowT = TypeVar("RowT", bound=ObjectRow)


class Judged(Protocol):
    """What reports need of any row: whether the object is right, and if not, how far off it is and why."""

    cell: str
    settings: dict[str, Any]
    dataset: str
    scene_id: int
    object: int
    object_name: str
    symmetry: Literal["none", "discrete", "continuous"]
    success_sym: bool
    stage: str | None
    reason: str | None

    @property
    def rotation_error_deg_sym(self) -> float | None:
        """Rotation error, deg, symmetry-aware; None where there is no motion."""
        ...

    @property
    def translation_error_cm_sym(self) -> float | None:
        """Translation error, cm, symmetry-aware; None where there is no motion."""
        ...


JudgedT = TypeVar("JudgedT", bound=Judged)


class Row(ObjectRow):
    """One goal object in one cell. Errors are None where there is no motion; it counts as a failure all the same.

    `in_current`: it is in the current scene too. One that is not is right without a motion, and has no errors.
    `success_equivalent`: this motion, or one that the goal image does not tell apart from it, is right.
    """

    in_current: bool = True
    status: Literal["estimated", "abstained", "failed", "missed"]
    stage: str | None = None
    reason: str | None = None
    rotation_error_deg: float | None = None
    translation_error_cm: float | None = None
    rotation_error_deg_sym: float | None = None
    translation_error_cm_sym: float | None = None
    success: bool = False
    success_sym: bool = False
    success_equivalent: bool = False
    T_goal_current: list[list[float]] | None = None
    confidence: float | None = None
    ambiguity: Ambiguity | None = None
    instance: int | None = None
    matcher_calls: int = 0
    correspondences: int = 0
    inliers: int = 0
    time_ms: dict[str, float] = {}
    cached: bool = False
    weights: dict[str, str] = {}


def append_rows(path: Path, rows: Sequence[ObjectRow]) -> None:
    """Append rows as JSON lines and force them to the disk, so that a killed run keeps them."""
    with path.open("a") as file:
        file.write("".join(row.model_dump_json() + "\n" for row in rows))
        file.flush()
        os.fsync(file.fileno())


def write_rows(path: Path, rows: Sequence[ObjectRow]) -> None:
    """Replace a rows file, whole or not at all."""
    write_text(path, "".join(row.model_dump_json() + "\n" for row in rows))


def read_rows(path: Path) -> list[Row]:
    """Read the rows of an ablation or evaluation, as `read_rows_as`."""
    return read_rows_as(Row, path)


def read_rows_as(model: type[RowT], path: Path) -> list[RowT]:
    """Read a rows file. A torn last line, as a kill leaves it, is left out.

    Raises:
        ToolkitError: another line is not a row.
    """
    lines = path.read_text().splitlines()
    rows: list[RowT] = []
    for number, line in enumerate(lines, start=1):
        try:
            rows.append(model.model_validate_json(line))
        except ValidationError as error:
            if number == len(lines):
                break
            raise ToolkitError(f"'{path}', line {number}: not a result row of this version") from error
    return rows


def by_cell(rows: Sequence[JudgedT]) -> dict[str, list[JudgedT]]:
    """The rows of every cell, in the order the cells first occur."""
    found: dict[str, list[JudgedT]] = {}
    for row in rows:
        found.setdefault(row.cell, []).append(row)
    return found


@dataclass(frozen=True)
class Estimate:
    """A figure with its 95 % interval."""

    value: float
    interval: Interval

    @staticmethod
    def of_share(outcomes: Sequence[bool]) -> Estimate:
        """The share of outcomes that are true, with its Wilson interval."""
        return Estimate(float(np.mean(outcomes)), wilson_interval(sum(outcomes), len(outcomes)))


@dataclass(frozen=True)
class CellSummary:
    """The figures of one cell; `_sym` ones take a model's symmetries into account.

    Medians are over the objects that are in the current scene, and count one without a motion as infinitely wrong;
    false alarms are the share of the others, `absent` of them, that were given a motion. Completion is the share of
    scenes of which every object is right (Table II). Intervals: Wilson for shares, bootstrap over scenes for medians.
    Times are medians over objects, in milliseconds.
    """

    cell: str
    settings: dict[str, Any]
    objects: int
    scenes: int
    rotation_median_deg: Estimate
    translation_median_cm: Estimate
    rotation_median_deg_sym: Estimate
    translation_median_cm_sym: Estimate
    rotation_p90_deg_sym: float
    translation_p90_cm_sym: float
    success: Estimate
    success_sym: Estimate
    completion: Estimate
    completion_sym: Estimate
    absent: int
    false_alarms: Estimate | None
    matcher_calls: float
    time_ms: dict[str, float]

    @property
    def total_ms(self) -> float:
        """Sum of the stages' median times, milliseconds per object."""
        return sum(self.time_ms.values())


def summarize(rows: Sequence[Row]) -> list[CellSummary]:
    """One summary per cell, in the order the cells first occur."""
    return [_summarize_cell(cell, of_cell) for cell, of_cell in by_cell(rows).items()]


def _summarize_cell(cell: str, rows: list[Row]) -> CellSummary:
    there = [row for row in rows if row.in_current]
    alarms = [row.T_goal_current is not None for row in rows if not row.in_current]
    scenes = np.array([row.scene_id for row in there])
    stages = dict.fromkeys(stage for row in rows for stage in row.time_ms)
    return CellSummary(
        cell=cell,
        settings=rows[0].settings,
        objects=len(rows),
        scenes=len({row.scene_id for row in rows}),
        rotation_median_deg=_median(errors(there, "rotation_error_deg"), scenes),
        translation_median_cm=_median(errors(there, "translation_error_cm"), scenes),
        rotation_median_deg_sym=_median(errors(there, "rotation_error_deg_sym"), scenes),
        translation_median_cm_sym=_median(errors(there, "translation_error_cm_sym"), scenes),
        rotation_p90_deg_sym=_p90(errors(there, "rotation_error_deg_sym")),
        translation_p90_cm_sym=_p90(errors(there, "translation_error_cm_sym")),
        success=Estimate.of_share([row.success for row in rows]),
        success_sym=Estimate.of_share([row.success_sym for row in rows]),
        completion=Estimate.of_share(_completed(rows, "success")),
        completion_sym=Estimate.of_share(_completed(rows, "success_sym")),
        absent=len(alarms),
        false_alarms=Estimate.of_share(alarms) if alarms else None,
        matcher_calls=float(np.mean([row.matcher_calls for row in rows])),
        time_ms={s: float(np.median([row.time_ms[s] for row in rows if s in row.time_ms])) for s in stages},
    )


def errors(rows: Sequence[Row], field: str) -> Float:
    """(N,) float64 errors of rows; infinite where there is no motion."""
    values = [getattr(row, field) for row in rows]
    return np.array([np.inf if value is None else value for value in values], np.float64)


def best_cell(rows: Sequence[Row]) -> str:
    """The cell with the largest share of right objects, the first of equals."""
    cells = by_cell(rows)
    return max(cells, key=lambda cell: np.mean([row.success_sym for row in cells[cell]]))


def worst_rows(rows: Sequence[Row], count: int) -> list[Row]:
    """Up to `count` rows that are wrong, those without a motion and those turned furthest off first."""
    wrong = [row for row in rows if not row.success_sym]
    off = errors(wrong, "rotation_error_deg_sym")
    return [wrong[i] for i in np.argsort(-off, kind="stable")[:count]]


def _completed(rows: Sequence[Row], field: str) -> list[bool]:
    scenes: dict[int, bool] = {}
    for row in rows:
        scenes[row.scene_id] = scenes.get(row.scene_id, True) and bool(getattr(row, field))
    return list(scenes.values())


def _lower_median(values: Float) -> float:
    """Median that is one of the values: the mean of a number and infinity says nothing."""
    # np.quantile(values, 0.5, method="inverted_cdf"), ten times as fast: the bootstrap asks a thousand times.
    middle = (len(values) - 1) // 2
    return float(np.partition(values, middle)[middle])


def _median(values: Float, scenes: np.ndarray) -> Estimate:
    return Estimate(_lower_median(values), bootstrap_interval(values, scenes, _lower_median))


def _p90(values: Float) -> float:
    return float(np.quantile(values, 0.9, method="inverted_cdf"))


def summary_lines(summaries: Sequence[object], comparisons: Sequence[object] = ()) -> list[dict[str, Any]]:
    """One line per cell: every figure with its interval, and how it compares with which other cell.

    Both are dataclasses with a `cell`.
    """
    compared = {line["cell"]: line for line in map(_flat, comparisons)}
    return [{**line, **_compared(compared.get(line["cell"], {}))} for line in map(_flat, summaries)]


def write_summary(path: Path, lines: Sequence[Mapping[str, Any]]) -> None:
    """Write summary.csv from `summary_lines`."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(dict.fromkeys(key for line in lines for key in line)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    write_text(path, buffer.getvalue())


def _compared(line: dict[str, Any]) -> dict[str, Any]:
    return {key if key == "against" else f"against_{key}": value for key, value in line.items() if key != "cell"}


def _flat(summary: object) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in vars(summary).items():
        if isinstance(value, Estimate):
            flat |= {key: value.value, f"{key}_low": value.interval[0], f"{key}_high": value.interval[1]}
        elif isinstance(value, PairedDifference):
            flat |= {key: value.mean, f"{key}_low": value.interval[0], f"{key}_high": value.interval[1]}
        elif key == "time_ms":
            flat |= {f"time_ms_{stage}": ms for stage, ms in value.items()}
        elif key != "settings":
            flat[key] = value
    return flat
