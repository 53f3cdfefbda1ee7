"""How many goal objects are given their right instance, for every way to decide. Prints Markdown.

    toolkit dataset build twins --scenes 20 --seed 0 --set lookalikes=twins --set min_objects=2
    python plugins/nerp_scene_graph/measure.py twins

Masks are the true ones, instances are k-means'. An object is right when its instance is of its own model and not given
away before: twins may be exchanged. `global` is as in the pipeline, where only instances that the descriptor cannot
tell apart are verified. `--every-pair` also verifies all, and leaves the descriptor's opinion out. `--light R G B`
multiplies the goal image's colours, as if it had been taken in another light.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from toolkit_nerp_scene_graph import NerpSceneGraph, NerpSceneGraphConfig

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.perception.assignment import assign_instances, contenders, instance_similarity
from toolkit.perception.crops import crop_region
from toolkit.perception.database import Database
from toolkit.perception.fusion import Models, RefineTask
from toolkit.perception.pipeline import Pipeline, Stages
from toolkit.perception.regions import true_owner
from toolkit.results.stats import paired_difference, wilson_interval
from toolkit.slots import SLOTS
from toolkit.stages import REGISTRIES
from toolkit.types import Capture, Frame

CHOICES = {
    "registration": "none",
    "segmenter": "oracle",
    "goal_segmenter": "oracle",
    "associator": "kmeans",
    "index": "numpy",
    "retriever": "instance_vote",
    "matcher": "sift",
    "pnp": "poselib",
    "refiner": "none",
}
REFERENCE = "global, render_compare"


def verifiers() -> dict[str, Any]:
    """Who answers `verify`. The graph needs no base: motions are not asked for."""
    return {
        "descriptor alone": REGISTRIES["refiner"].create("none"),
        "render_compare": REGISTRIES["refiner"].create("render_compare"),
        "graph without edges": NerpSceneGraph(NerpSceneGraphConfig(base="none", rounds=0)),
        "graph": NerpSceneGraph(NerpSceneGraphConfig(base="none")),
    }


def choose(pipeline: Pipeline, database: Database, goal: Frame, every_pair: bool) -> dict[str, tuple[list[int], float]]:
    """The instance of every goal object and the seconds of verification, by who decides."""
    segments = pipeline.stages.goal_segmenter.segment(goal, database.frames)
    descriptor = pipeline.stages.descriptor
    queries = descriptor.describe([crop_region(goal.rgb, s, descriptor.crop_size) for s in segments])
    similarity = queries @ database.descriptors.T
    starts = [
        pipeline.stages.retriever.start(np.argsort(-row, kind="stable"), database.instances, database.observations)
        for row in similarity
    ]
    chosen = {"vote": ([int(database.instances[start.next(1)[0]]) for start in starts], 0.0)}
    scores, models = instance_similarity(similarity, database.instances), Models(database)
    models.all()  # fused before the clock starts: every refiner needs them
    asked = {"global": (contenders(scores), scores)}
    if every_pair:
        asked["every pair"] = np.ones(scores.shape, bool), np.zeros(scores.shape)
    for how, (which, prior) in asked.items():
        for name, refiner in verifiers().items():
            verified, begin = np.full(scores.shape, np.nan), time.perf_counter()
            for number, instance in np.argwhere(which):
                found = refiner.verify(RefineTask.of(goal, segments, number, int(instance), models))
                verified[number, instance] = np.nan if found is None else found
            seconds = time.perf_counter() - begin
            chosen[f"{how}, {name}"] = assign_instances(prior, verified).tolist(), seconds
    chosen.pop("every pair, descriptor alone", None)
    return chosen


def right(capture: Capture, database: Database, masks: Sequence[np.ndarray], chosen: Sequence[int]) -> list[bool]:
    """Whether each goal object has an instance of its model that none before it has."""
    kinds = {key: truth.model.object_id for key, truth in (capture.truth or {}).items()}
    kind_of = {k: kinds.get(_owner(database, k), -1) for k in np.unique(database.instances).tolist()}
    taken: set[int] = set()
    answers: list[bool] = []
    for mask, instance in zip(masks, chosen, strict=True):
        wanted = kinds[true_owner(capture.goal.true_masks or {}, mask)]
        answers.append(instance not in taken and kind_of.get(instance) == wanted)
        taken |= {instance} if answers[-1] else set()
    return answers


def _owner(database: Database, instance: int) -> int:
    """The object that an instance's regions show most often."""
    masks: Mapping[int, np.ndarray]
    owners: Counter[int] = Counter()
    for row in database.instance(instance):
        masks = database.frame_of(row).true_masks or {}
        owners[true_owner(masks, database.regions[row].segment.mask)] += 1
    return owners.most_common(1)[0][0]


def main() -> None:
    """Decide every scene in every way."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("datasets", type=Path, nargs="+")
    parser.add_argument("--scenes", type=int, default=20)
    parser.add_argument("--descriptor", default="color_hist")
    parser.add_argument("--light", type=float, nargs=3, default=[1.0, 1.0, 1.0])
    parser.add_argument("--every-pair", action="store_true")
    options = parser.parse_args()
    choices = {**CHOICES, "descriptor": options.descriptor}
    pipeline = Pipeline(Stages(**{slot: REGISTRIES[stage].create(choices[slot]) for slot, stage in SLOTS.items()}))
    print("| scenes | decided by | objects | right | more than render_compare, points | ms per scene |")
    print("| --- | --- | --- | --- | --- | --- |")
    for folder in options.datasets:
        found: dict[str, list[bool]] = {}
        seconds: dict[str, list[float]] = {}
        scenes: list[int] = []
        for number, path in enumerate(read_dataset(folder)[: options.scenes]):
            capture = load_capture(path)
            lit = np.clip(capture.goal.rgb * np.array(options.light), 0, 255).astype(np.uint8)
            capture = replace(capture, goal=replace(capture.goal, rgb=lit))
            database = pipeline.build_database(capture.current)
            masks = [s.mask for s in pipeline.stages.goal_segmenter.segment(capture.goal, database.frames)]
            for name, (chosen, spent) in choose(pipeline, database, capture.goal, options.every_pair).items():
                found.setdefault(name, []).extend(right(capture, database, masks, chosen))
                seconds.setdefault(name, []).append(spent)
            scenes += [number] * len(masks)
            said = {name: sum(answers) for name, answers in found.items()}
            print(f"{folder.name} {number}: {len(scenes)} objects, right {said}", file=sys.stderr, flush=True)
        for name, answers in found.items():
            low, high = wilson_interval(sum(answers), len(answers))
            share = f"{np.mean(answers):.1%} [{low:.0%}, {high:.0%}]"
            more = cost = ""
            if name != REFERENCE:
                gain = paired_difference(answers, found[REFERENCE], scenes)
                more = f"{100 * gain.mean:+.1f} [{100 * gain.interval[0]:+.1f}, {100 * gain.interval[1]:+.1f}]"
            if np.median(seconds[name]) > 1e-3:
                cost = f"{1000 * float(np.median(seconds[name])):.0f}"
            print(f"| {folder.name} | {name} | {len(answers)} | {share} | {more} | {cost} |", flush=True)


if __name__ == "__main__":
    main()
