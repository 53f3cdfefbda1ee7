"""Retrieval by every descriptor on the same crops of the same scenes, side by side; prints Markdown.

toolkit dataset build captures --objects ../shared/objects --scenes 20 --seed 0
python experiments/benchmarks/descriptors.py captures --descriptor color_hist --descriptor hog --descriptor gem \
    --descriptor mixvpr

Queries are the goal image's objects, the database is every region of the current frames, masks are true. Recall: the
most similar region shows the query's object. View error: azimuth, about the object, between the query's view and that
of the right object's most similar region. `--held-out` counts only objects that training never saw (procedural objects;
it never saw any scan).
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from toolkit.crops import crop_region
from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.progress import Progress
from toolkit.stages import DESCRIPTORS, Descriptor
from toolkit.stats import bootstrap_interval, wilson_interval
from toolkit.training.mixvpr import azimuth_gap_deg
from toolkit.training.pool import is_held_out
from toolkit.types import Camera, Capture, Crop, Float, Frame, Segment, TrueObject

_MIN_PIXELS = 100


@dataclass(frozen=True)
class Seen:
    """One object in one image: which, from which azimuth (radians, in its own frame), and its mask."""

    object_id: int
    azimuth: float
    frame: Frame
    segment: Segment


@dataclass(frozen=True)
class Outcome:
    """One query: whether the right object came first, and azimuth gaps in degrees, reached and least."""

    scene: int
    right: bool
    gap: float
    least: float


def azimuth(camera: Camera, T_world_object: Float, center: Float) -> float:
    """From where a camera sees an object, about the vertical through its centre, in the object's own turn."""
    at = T_world_object[:3, :3] @ center + T_world_object[:3, 3]
    out = T_world_object[:3, :3].T @ (camera.T_world_camera[:3, 3] - at)
    return float(np.arctan2(out[1], out[0]))


def seen_in(frame: Frame, truth: dict[int, tuple[TrueObject, Float]]) -> list[Seen]:
    """Every object of a frame that shows enough of itself."""
    found: list[Seen] = []
    for object_id, mask in (frame.true_masks or {}).items():
        if mask.sum() >= _MIN_PIXELS:
            true, T = truth[object_id]
            found.append(Seen(object_id, azimuth(frame.camera, T, true.model.center), frame, Segment(mask)))
    return found


def evaluate(descriptor: Descriptor, scene: int, capture: Capture, held_out: bool) -> tuple[list[Outcome], float, int]:
    """All queries of a capture; seconds and number of crops."""
    assert capture.truth is not None
    current = {i: (true, true.T_world_current) for i, true in capture.truth.items()}
    goal = {i: (true, true.T_world_goal) for i, true in capture.truth.items()}
    database = [seen for frame in capture.current for seen in seen_in(frame, current)]
    queries = seen_in(capture.goal, goal)
    crops = [crop(seen, descriptor.crop_size) for seen in (*database, *queries)]
    start = time.perf_counter()
    vectors = descriptor.describe(crops)
    seconds = time.perf_counter() - start
    similarity = vectors[len(database) :] @ vectors[: len(database)].T
    ids, azimuths = np.array([s.object_id for s in database]), np.array([s.azimuth for s in database])
    outcomes: list[Outcome] = []
    for query, row in zip(queries, similarity, strict=True):
        own = ids == query.object_id
        if not own.any() or (held_out and not is_held_out(capture.truth[query.object_id].model.name)):
            continue
        gaps = azimuth_gap_deg(azimuths, np.asarray(query.azimuth))
        best = int(np.where(own, row, -2).argmax())
        outcomes.append(Outcome(scene, bool(own[row.argmax()]), float(gaps[best]), float(gaps[own].min())))
    return outcomes, seconds, len(crops)


def crop(seen: Seen, size: int) -> Crop:
    """The crop the pipeline would make."""
    return crop_region(seen.frame.rgb, seen.segment, size)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--descriptor", action="append", help="all when left out")
    parser.add_argument("--held-out", action="store_true", help="only procedural objects that training never saw")
    options = parser.parse_args()
    captures = [load_capture(folder) for folder in read_dataset(options.dataset)]
    lines: list[str] = []
    for name in options.descriptor or DESCRIPTORS.names():
        descriptor = DESCRIPTORS.create(name)
        outcomes: list[Outcome] = []
        seconds, crops = 0.0, 0
        with Progress(Console(stderr=True)).step(name, len(captures)) as advance:
            for number, capture in enumerate(captures):
                found, spent, count = evaluate(descriptor, number, capture, options.held_out)
                outcomes, seconds, crops = outcomes + found, seconds + spent, crops + count
                advance(1)
        right = sum(outcome.right for outcome in outcomes)
        low, high = wilson_interval(right, len(outcomes))
        gaps = np.array([outcome.gap for outcome in outcomes])
        near = float(np.mean(gaps <= np.array([outcome.least for outcome in outcomes]) + 1e-9))
        scenes = np.array([outcome.scene for outcome in outcomes])
        median = bootstrap_interval(gaps, scenes, lambda v: float(np.median(v)))
        lines.append(
            f"| {name} | {len(outcomes)} | {100 * right / len(outcomes):.0f} [{100 * low:.0f}, {100 * high:.0f}] % "
            f"| {np.median(gaps):.0f} [{median[0]:.0f}, {median[1]:.0f}] | {np.mean(gaps > 90) * 100:.0f} % "
            f"| {100 * near:.0f} % | {1000 * seconds / crops:.1f} |"
        )
    least = np.median([outcome.least for outcome in outcomes])
    print(
        "| descriptor | queries | recall@1 | view error, deg | beyond 90 deg | nearest view found | ms a crop |\n"
        "| --- | --- | --- | --- | --- | --- | --- |"
    )
    print("\n".join(lines))
    print(f"\nThe nearest view there is lies {least:.0f} deg away in the median.")


if __name__ == "__main__":
    main()
