"""Retrieval by every descriptor on the same crops of the same scenes, side by side; prints Markdown.

toolkit dataset build captures --objects ../shared/objects --scenes 20 --seed 0
python experiments/benchmarks/descriptors.py captures --descriptor color_hist --descriptor hog --descriptor gem \
    --descriptor mixvpr

Queries are the goal image's objects, the database is every region of the current frames, masks are true. Recall: the
most similar region shows the query's object. View error: azimuth, about the object, between the query's view and that
of the right object's most similar region. `--held-out` counts only objects that training never saw (procedural objects;
it never saw any scan). `--together` searches the regions of all scenes, each under its own light, for every query: a
database of all objects there are.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from rich.console import Console

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.perception.crops import crop_region
from toolkit.progress import Progress
from toolkit.results.stats import bootstrap_interval, wilson_interval
from toolkit.stages import DESCRIPTORS, Descriptor
from toolkit.training.mixvpr import azimuth_gap_deg
from toolkit.training.pool import is_held_out
from toolkit.types import Camera, Capture, Crop, Float, Frame, Segment, TrueObject

_MIN_PIXELS = 100


@dataclass(frozen=True)
class Seen:
    """One object in one image: which, from which azimuth (radians, in its own frame), and its mask."""

    name: str
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


@dataclass(frozen=True)
class Search:
    """Goal objects of some scenes, and the regions they are looked for in."""

    scenes: tuple[int, ...]
    queries: tuple[Seen, ...]
    database: tuple[Seen, ...]


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
            model = true.model
            found.append(Seen(model.name, azimuth(frame.camera, T, model.center), frame, Segment(mask)))
    return found


def search_of(scene: int, capture: Capture) -> Search:
    """What one scene asks, and of what."""
    assert capture.truth is not None
    current = {i: (true, true.T_world_current) for i, true in capture.truth.items()}
    goal = {i: (true, true.T_world_goal) for i, true in capture.truth.items()}
    queries = tuple(seen_in(capture.goal, goal))
    database = tuple(seen for frame in capture.current for seen in seen_in(frame, current))
    return Search((scene,) * len(queries), queries, database)


def joined(searches: Sequence[Search]) -> Search:
    """All of them as one."""
    parts = [[getattr(s, name) for s in searches] for name in ("scenes", "queries", "database")]
    return Search(*(tuple(chain.from_iterable(part)) for part in parts))


def evaluate(descriptor: Descriptor, search: Search, held_out: bool) -> tuple[list[Outcome], float, int]:
    """All queries of a search; seconds and number of crops."""
    crops = [crop(seen, descriptor.crop_size) for seen in (*search.database, *search.queries)]
    start = time.perf_counter()
    vectors = descriptor.describe(crops)
    seconds = time.perf_counter() - start
    count = len(search.database)
    similarity = vectors[count:] @ vectors[:count].T
    names, azimuths = np.array([s.name for s in search.database]), np.array([s.azimuth for s in search.database])
    outcomes: list[Outcome] = []
    for scene, query, row in zip(search.scenes, search.queries, similarity, strict=True):
        own = names == query.name
        if not own.any() or (held_out and not is_held_out(query.name)):
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
    parser.add_argument("--together", action="store_true", help="one database of all scenes' regions")
    options = parser.parse_args()
    searches = [search_of(n, load_capture(folder)) for n, folder in enumerate(read_dataset(options.dataset))]
    searches = [joined(searches)] if options.together else searches
    lines: list[str] = []
    for name in options.descriptor or DESCRIPTORS.names():
        descriptor = DESCRIPTORS.create(name)
        outcomes: list[Outcome] = []
        seconds, crops = 0.0, 0
        with Progress(Console(stderr=True)).step(name, len(searches)) as advance:
            for search in searches:
                found, spent, count = evaluate(descriptor, search, options.held_out)
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
        "| descriptor | queries | recall@1 | view error, deg | beyond 90 deg | nearest view found | ms per crop |\n"
        "| --- | --- | --- | --- | --- | --- | --- |"
    )
    print("\n".join(lines))
    print(f"\nThe nearest view there is lies {least:.0f} deg away in the median.")


if __name__ == "__main__":
    main()
