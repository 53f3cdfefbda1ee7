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
from toolkit.harness.experiment import expand, load_experiment
from toolkit.harness.worker import make_runner
from toolkit.perception.fusion import FusedModel, Models, Start
from toolkit.perception.lighting import estimate_light
from toolkit.perception.refiners.comparing.cloud import Cloud
from toolkit.perception.refiners.comparing.combine import agreeing
from toolkit.perception.refiners.comparing.compare import Hypothesis, compare
from toolkit.perception.refiners.comparing.confidence import features
from toolkit.perception.refiners.comparing.goal import LEVELS_PX, view_goal
from toolkit.perception.refiners.comparing.likeness import unlikeness
from toolkit.perception.refiners.render_compare import RenderCompare
from toolkit.perception.scene import starts_of
from toolkit.results.metrics import PoseError, assign_goal_objects, pose_error
from toolkit.types import Float

EXPECTED_WRONG = 0.06
BINS = (0.0, 0.2, 0.5, 0.8, 0.9, 0.95, 1.0)
MATCHES_ONLY = {f"pipeline.{slot}": ["oracle"] for slot in ("segmenter", "goal_segmenter", "associator")} | {
    "pipeline.refiner": ["none"]
}


def samples(capture_folder: Path) -> list[list[float]]:
    """Rows of features and whether the hypothesis is right, for every object of a capture."""
    cell = expand(load_experiment("estimate", MATCHES_ONLY))[0]
    pipeline = make_runner(cell, None).pipeline
    capture = load_capture(capture_folder)
    database = pipeline.build_database(capture.current)
    assert capture.truth is not None and capture.goal.true_masks is not None
    estimates = pipeline.estimate(database, capture.goal)
    objects = assign_goal_objects([e.segment for e in estimates], capture.goal.true_masks)
    models, rows = Models(database), []
    light = estimate_light(models.all())
    for i, number in objects.items():
        estimate = estimates[number]
        model = None if estimate.instance is None else models.get(estimate.instance)
        if not isinstance(model, FusedModel):
            continue
        others = [e.segment for e in estimates if e is not estimate]
        goal, starts = view_goal(capture.goal, estimate.segment, others), starts_of(estimate)
        motions = [start.T_goal_current for start in starts]
        cloud = Cloud(model, LEVELS_PX, light)
        found = compare(cloud, goal, motions, RenderCompare().search(cloud))
        errors = [pose_error(h.T_goal_current, capture.truth[i]) for h in found]
        rows.append([*_judged_by(found, model, starts), float(errors[0].success_sym)])
        wrong = [h for h, e in zip(found, errors, strict=True) if not _near(e)]
        if 0 < len(wrong) < len(found):
            rows.append([*_judged_by(wrong, model, starts), 0.0])
    return rows


def _judged_by(found: list[Hypothesis], model: FusedModel, starts: tuple[Start, ...]) -> Float:
    unlike = unlikeness(model, [h.T_goal_current for h in found])
    return features(found, unlike, supported=bool(agreeing(found[0].T_goal_current, model.center, starts)))


def _near(error: PoseError) -> bool:
    """Neither right nor clearly wrong answers teach anything as wrong ones."""
    return error.rotation_error_deg_sym < 10 and error.translation_error_cm_sym < 3


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
