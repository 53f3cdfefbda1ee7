"""Show what becomes of the motions when the world is turned: captures as they are, and in random rigid worlds.

toolkit dataset build worlds/clean --scenes 20 --seed 41 --set views=4 --set max_objects=4     (and d435, realsense)
python experiments/benchmarks/worlds.py worlds/* --worlds 3
python experiments/benchmarks/worlds.py worlds/* --tilt 5

Worlds are turned about any axis, with their origin anywhere within 3 m; with --tilt they lean by so many degrees into a
random direction. Motions are taken back into the world of the capture before they are compared and scored. An
answer is the same if it is no motion in both, or the two are within half a degree and a millimetre at the object.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from toolkit import Session
from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.errors import ToolkitError
from toolkit.geometry import invert, make_transform, rotation_angle, transform_points
from toolkit.results.answer import SURE
from toolkit.results.scoring import score
from toolkit.types import Capture, Float, PoseEstimate

REACH_M = 3.0
SAME_DEG, SAME_M = 0.5, 0.001


def world(rng: np.random.Generator, tilt_deg: float | None) -> Float:
    """(4, 4) into another world: any, or one that leans."""
    if tilt_deg is None:
        return make_transform(Rotation.random(rng=rng).as_matrix(), rng.uniform(-REACH_M, REACH_M, 3))
    towards = rng.uniform(-np.pi, np.pi)
    axis = np.array([np.cos(towards), np.sin(towards), 0])
    return make_transform(Rotation.from_rotvec(np.radians(tilt_deg) * axis).as_matrix(), np.zeros(3))


def estimates_in(session: Session, capture: Capture, T: Float) -> list[PoseEstimate]:
    """What the session says of the capture in another world, taken back to its own; nothing where it refuses."""
    try:
        session.database([frame.moved(T) for frame in capture.current])
        return [e.in_world(invert(T)) for e in session.estimate(capture.goal.moved(T))]
    except ToolkitError as error:
        print(f"{capture.name}: {error}")
        return []


def tally(capture: Capture, estimates: list[PoseEstimate]) -> Counter[str]:
    """How many objects there are and are right, and how many answers are wrong and sure."""
    rows = score(capture, estimates)
    wrong = [r for r in rows if not r.success_sym and (r.confidence or 0) > SURE and r.rotation_error_deg is not None]
    return Counter(objects=len(rows), right=sum(r.success_sym for r in rows), sure_and_wrong=len(wrong))


def compare(
    straight: list[PoseEstimate], turned: list[PoseEstimate], places: dict[int, Float]
) -> tuple[Counter[str], list[Float]]:
    """How many answers are the same, and (turn in deg, shift in cm) of all pairs of motions.

    Args:
        straight: of the capture as it is.
        turned: of the capture in another world, taken back.
        places: (3,) by instance of `turned`.
    """
    counts: Counter[str] = Counter(answers=max(len(straight), len(turned)))
    apart: list[Float] = []
    for a in straight:
        b = max(turned, key=lambda other: float((a.segment.mask & other.segment.mask).sum()), default=None)
        if b is None or not (a.segment.mask & b.segment.mask).any():
            continue
        if a.T_goal_current is None or b.T_goal_current is None or b.instance is None:
            counts["same"] += a.T_goal_current is b.T_goal_current
            continue
        place = places[b.instance][None]
        turn = float(np.degrees(rotation_angle(a.T_goal_current[:3, :3] @ b.T_goal_current[:3, :3].T)))
        shift = float(np.linalg.norm(a.move(place) - b.move(place)))
        apart.append(np.array([turn, shift * 100]))
        counts["same"] += turn < SAME_DEG and shift < SAME_M
    return counts, apart


def places_in(session: Session, T: Float) -> dict[int, Float]:
    """(3,) middle of every instance that the session has seen, in the world that (4, 4) `T` takes into its own."""
    database = session.scene.database
    seen = {i: [database.regions[row].points for row in database.instance(i)] for i in set(database.instances.tolist())}
    return {i: transform_points(invert(T), np.concatenate(points)).mean(axis=0) for i, points in seen.items()}


def main() -> None:
    """Print one line per dataset."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("datasets", nargs="+", type=Path)
    parser.add_argument("--worlds", type=int, default=1, help="worlds per capture")
    parser.add_argument("--tilt", type=float, help="degrees that every world leans by")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    session = Session("estimate")
    print(
        "| captures | worlds | objects | right | turned | sure and wrong | turned | same |",
        end="",
    )
    print(" turn apart p50, p90 | shift apart p50, p90 |")
    print("| --- " * 10 + "|", flush=True)
    for dataset in options.datasets:
        total: Counter[str] = Counter()
        apart: list[Float] = []
        for number, folder in enumerate(read_dataset(dataset)):
            capture = replace(load_capture(folder), name=f"{dataset.name}/{folder.name}")
            straight = estimates_in(session, capture, np.eye(4))
            before = tally(capture, straight)
            rng = np.random.default_rng([options.seed, number])
            for _ in range(options.worlds):
                T = world(rng, options.tilt)
                turned = estimates_in(session, capture, T)
                counts, distances = compare(straight, turned, places_in(session, T) if turned else {})
                after = tally(capture, turned)
                total += counts + Counter(
                    {f"before {k}": n for k, n in before.items()} | {f"after {k}": n for k, n in after.items()}
                )
                total["worlds"] += 1
                apart += distances
        print(_line(dataset.name, total, np.array(apart).reshape(-1, 2)), flush=True)


def _line(name: str, total: Counter[str], apart: Float) -> str:
    turn, shift = np.quantile(apart, (0.5, 0.9), axis=0).T if len(apart) else np.full((2, 2), np.nan)
    cells = [
        name,
        total["worlds"],
        total["before objects"],
        *(total[f"{when} right"] for when in ("before", "after")),
        *(total[f"{when} sure_and_wrong"] for when in ("before", "after")),
        f"{total['same']} of {total['answers']}",
        f"{turn[0]:.3f}, {turn[1]:.2f} deg",
        f"{shift[0]:.4f}, {shift[1]:.3f} cm",
    ]
    return f"| {' | '.join(map(str, cells))} |"


if __name__ == "__main__":
    main()
