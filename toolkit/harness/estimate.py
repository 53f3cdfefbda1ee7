"""Captures from disk -> poses.json and pictures; scored rows where the truth is present."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.files import writing
from toolkit.harness.experiment import Cell
from toolkit.harness.runs import resolve, writable, write_meta, write_resolved
from toolkit.harness.session import Session
from toolkit.perception.checks.capture import RefusedError, refuse
from toolkit.perception.database import Database
from toolkit.perception.fusion import Clouds
from toolkit.pictures.findings import illustrated
from toolkit.pictures.poses import missing_instances, write_poses
from toolkit.progress import Progress
from toolkit.results.folder import ROWS, SUMMARY
from toolkit.results.rows import Row, summarize, summary_lines, write_rows, write_summary
from toolkit.results.scoring import score
from toolkit.types import Capture, Finding, Float, PoseEstimate


@dataclass(frozen=True)
class Answer:
    """What is known of one capture.

    Attributes:
        estimates: one per goal object.
        database: of the current scene, its instances as the goal shows them.
        clouds: of all of its instances.
        findings: what was found wrong with the capture, worst first.
    """

    estimates: list[PoseEstimate]
    database: Database
    clouds: Clouds
    findings: list[Finding]

    def points(self) -> list[Float | None]:
        """For every estimate the (N, 3) world points seen of its instance, metres; None where it has none."""
        rows = [[] if e.instance is None else self.database.instance(e.instance) for e in self.estimates]
        regions = self.database.regions
        return [np.concatenate([regions[row].points for row in own]) if own else None for own in rows]

    def missing(self) -> list[int]:
        """Instances of the current scene that no goal object is taken for."""
        return missing_instances(self.database, self.estimates)


def estimate_folder(capture: Path, cell: Cell, out: Path, progress: Progress, masks: Path | None = None) -> Answer:
    """Estimate one capture folder; writes OUT/poses.json, masks and pictures.

    Args:
        capture: the folder.
        cell: the settings to run.
        out: where it writes to.
        progress: is told what is being done, and what of the capture was not used, or used otherwise than it is stored.
        masks: a folder of a user's own masks, for the segmenter `masks`.

    Raises:
        ToolkitError: the capture cannot be read or cannot be right, a stage lacks something, or OUT cannot be written.
    """
    session = Session(cell)
    return estimate_capture(read_capture(capture, progress, masks), session, out, progress)


def evaluate_folder(dataset: Path, cell: Cell, out: Path, progress: Progress) -> list[Row]:
    """Estimate every capture of a folder into OUT/<capture>/, and score those with truth into OUT/rows.jsonl.

    A capture that cannot be right is said to be so, and all its objects count as missed.

    Returns:
        The rows; empty where no capture has truth.

    Raises:
        ToolkitError: as `estimate_folder`, but for captures that cannot be right.
    """
    session = Session(cell)
    captures = read_dataset(dataset)
    source = {"path": str(dataset.resolve())}
    with writing(f"'{out}'"):
        out.mkdir(parents=True, exist_ok=True)
        write_resolved(out, resolve("evaluate", [replace(cell, dataset=source).resolved()]))
        write_meta(out, {"title": f"Captures of {dataset.resolve().name}"}, session.weights, [source])
    rows: list[Row] = []
    with progress.step("Evaluating", len(captures)) as advance:
        for scene_id, folder in enumerate(captures):
            capture = read_capture(folder, progress)
            try:
                estimates = estimate_capture(capture, session, out / capture.name, progress).estimates
            except RefusedError as refused:
                progress.say(f"{capture.name}: {refused}")
                estimates = []
            if capture.truth is not None and capture.goal.true_masks is not None:
                rows += score(capture, estimates, cell=cell.name, scene_id=scene_id, weights=session.weights)
                with writable(f"'{out}'"):
                    write_rows(out / ROWS, rows)
            advance(1)
    if rows:
        with writable(f"'{out}'"):
            write_summary(out / SUMMARY, summary_lines(summarize(rows)))
    return rows


def read_capture(folder: Path, progress: Progress, masks: Path | None = None) -> Capture:
    """Read a capture folder, and say what of it is not used, or used otherwise than it is stored."""
    progress.now(f"Reading {folder.name}")
    capture = load_capture(folder, masks)
    for note in capture.notes:
        progress.say(f"{capture.name}: {note}")
    return capture


def estimate_capture(capture: Capture, session: Session, out: Path, progress: Progress) -> Answer:
    """Estimate a capture that was read; writes OUT/poses.json, masks and pictures. The session keeps the scene."""
    progress.now("Looking at the current frames")
    try:
        session.database(capture.current)
        progress.now("Looking for the motions towards the goal")
        estimates = session.estimate(capture.goal)
    except RefusedError:
        with writing(f"'{out}'"):
            refuse(illustrated(out, capture.current, capture.goal, session.findings))
        raise
    with writing(f"'{out}'"):
        findings = illustrated(out, capture.current, capture.goal, session.findings)
    for finding in findings:
        progress.say(f"{capture.name}: {finding.severity}: {finding.sentence}")
    progress.now("Writing")
    answer = Answer(estimates, session.scene.database, session.scene.clouds(), findings)
    with writing(f"'{out}'"):
        write_poses(out, capture, answer.database, answer.clouds, estimates, findings)
    return answer
