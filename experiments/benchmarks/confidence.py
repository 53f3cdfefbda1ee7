"""Fit the refiners' confidence on one folder of captures and show how reliable it is on another.

toolkit dataset build train --scenes 150 --seed 0
toolkit dataset build test --scenes 40 --seed 0 --objects ../shared/objects
python experiments/benchmarks/confidence.py train test

Every object gives its best hypothesis, and what would have been the best had the right ones been missing: wrong
answers are too rare to learn from. The latter count as much as wrong answers are expected, 6 in 100.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from sklearn.linear_model import LogisticRegression

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.experiment import create_stage, expand, load_experiment, own_settings
from toolkit.fusion import FusedModel, Models
from toolkit.lighting import estimate_light
from toolkit.metrics import PoseError, pose_error
from toolkit.pipeline import Pipeline, Stages
from toolkit.refiners.cloud import Cloud
from toolkit.refiners.compare import Hypothesis, compare
from toolkit.refiners.confidence import features
from toolkit.refiners.goal import LEVELS_PX, view_goal
from toolkit.refiners.likeness import unlikeness
from toolkit.refiners.render_compare import RenderCompare
from toolkit.slots import SLOTS
from toolkit.types import Float, Segment

EXPECTED_WRONG = 0.06
BINS = (0.0, 0.2, 0.5, 0.8, 0.9, 0.95, 1.0)
ORACLES = {"pipeline.segmenter": ["oracle"], "pipeline.goal_segmenter": ["oracle"], "pipeline.associator": ["oracle"]}


def samples(capture_folder: Path) -> list[list[float]]:
    """Rows of features and whether the hypothesis is right, for every object of a capture."""
    cell = expand(load_experiment("estimate", ORACLES))[0]
    stages = Stages(**{slot: create_stage(cell.pipeline, slot) for slot in SLOTS})
    capture = load_capture(capture_folder)
    database = Pipeline(stages, own_settings(cell.pipeline)).build_database(capture.current)
    assert capture.truth is not None and capture.goal.true_masks is not None
    segments = {i: Segment(mask) for i, mask in capture.goal.true_masks.items()}
    models, rows = Models(database), []
    light = estimate_light(models.all())
    for i, segment in segments.items():
        instance = next((int(database.instances[r]) for r in range(len(database)) if _shows(database, r, i)), None)
        model = None if instance is None else models.get(instance)
        if not isinstance(model, FusedModel):
            continue
        goal = view_goal(capture.goal, segment, [s for s in segments.values() if s is not segment])
        found = compare(Cloud(model, LEVELS_PX, light), goal, (), RenderCompare().search())
        errors = [pose_error(h.T_goal_current, capture.truth[i]) for h in found]
        rows.append([*_judged_by(found, model), float(errors[0].success_sym)])
        wrong = [h for h, e in zip(found, errors, strict=True) if not _near(e)]
        if 0 < len(wrong) < len(found):
            rows.append([*_judged_by(wrong, model), 0.0])
    return rows


def _judged_by(found: list[Hypothesis], model: FusedModel) -> Float:
    return features(found, unlikeness(model, [h.T_goal_current for h in found]))


def _near(error: PoseError) -> bool:
    """Neither right nor clearly wrong answers teach anything as wrong ones."""
    return error.rotation_error_deg_sym < 10 and error.translation_error_cm_sym < 3


def _shows(database, row: int, instance: int) -> bool:
    mask = database.regions[row].segment.mask
    truth = (database.frame_of(row).true_masks or {}).get(instance)
    return truth is not None and (mask & truth).sum() > 0.5 * mask.sum()


def collect(dataset: Path) -> tuple[Float, Float, Float]:
    """Features (N, F), outcomes (N,) and weights (N,) of a folder of captures."""
    parts = Parallel(n_jobs=-1)(delayed(samples)(capture) for capture in read_dataset(dataset))
    table = np.array([row for part in parts for row in part])
    right = table[:, -1]
    return table[:, :-1], right, np.where(right == 1, 1.0, EXPECTED_WRONG)


def main() -> None:
    """Print weights, bias and the reliability table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("train", type=Path)
    parser.add_argument("test", type=Path)
    options = parser.parse_args()
    X, y, weight = collect(options.train)
    model = LogisticRegression(C=1, max_iter=5000).fit(X, y, sample_weight=weight)
    print("weights", model.coef_[0].round(3).tolist(), "bias", model.intercept_[0].round(3))
    X, y, weight = collect(options.test)
    p = model.predict_proba(X)[:, 1]
    print("| confidence | samples | mean confidence | right |\n| --- | --- | --- | --- |")
    for low, high in pairwise(BINS):
        rows = (p >= low) & (p < high)
        if rows.any():
            mean, share = (np.average(v[rows], weights=weight[rows]) for v in (p, y))
            print(f"| {low:.2f} to {high:.2f} | {rows.sum()} | {mean:.2f} | {share:.2f} |")


if __name__ == "__main__":
    main()
