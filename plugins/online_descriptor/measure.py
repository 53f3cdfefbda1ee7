"""Retrieval recall gained by adapting to the scene, for the seconds spent. Prints Markdown.

    toolkit dataset build scenes --scenes 40 --seed 0 --set lookalikes=recolored
    python plugins/online_descriptor/measure.py scenes --scenes 40

Masks are the true ones: a goal object is right when the region most similar to it is of the same object.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from toolkit_online_descriptor import OnlineDescriptor, OnlineDescriptorConfig

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.perception.crops import crop_region
from toolkit.results.stats import paired_difference, wilson_interval
from toolkit.types import Frame, Segment


def crops_of(frame: Frame, size: int):
    """The frame's objects, and which they are."""
    masks = sorted((frame.true_masks or {}).items())
    seen = [(key, mask) for key, mask in masks if mask.sum() >= 50]
    return [crop_region(frame.rgb, Segment(mask), size) for _, mask in seen], [key for key, _ in seen]


def main() -> None:
    """Describe every scene once, and search it with and without adaptation."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--scenes", type=int, default=40)
    parser.add_argument("--bases", nargs="+", default=["color_hist", "hog"])
    parser.add_argument("--shrinkage", nargs="+", type=float, default=[0.01, 0.1, 1.0])
    options = parser.parse_args()
    found: dict[tuple[str, str], list[bool]] = {}
    seconds: dict[tuple[str, str], list[float]] = {}
    scenes: dict[str, list[int]] = {base: [] for base in options.bases}
    for number, folder in enumerate(read_dataset(options.dataset)[: options.scenes]):
        capture = load_capture(folder)
        for base in options.bases:
            plain = OnlineDescriptor(OnlineDescriptorConfig(base=base))
            crops, owners = [], []
            for frame in capture.current:
                own, keys = crops_of(frame, plain.crop_size)
                crops += own
                owners += keys
            rows, instances = plain.describe(crops), np.unique(owners, return_inverse=True)[1]
            goal_crops, wanted = crops_of(capture.goal, plain.crop_size)
            if len(set(owners)) < 2 or not goal_crops:
                continue  # with one object there is nothing to tell apart
            queries = plain.describe(goal_crops)
            scenes[base] += [number] * len(wanted)
            for name, shrinkage in [("as it is", None), *((f"shrinkage {s:g}", s) for s in options.shrinkage)]:
                start = time.perf_counter()
                database, asked = rows, queries
                if shrinkage is not None:
                    online = OnlineDescriptor(OnlineDescriptorConfig(base=base, shrinkage=shrinkage))
                    learnt = online.adapt(rows, instances)
                    database, asked = learnt(rows), learnt(queries)
                seconds.setdefault((base, name), []).append(time.perf_counter() - start)
                best = (asked @ database.T).argmax(axis=1)
                right = [owners[row] == key for row, key in zip(best, wanted, strict=True)]
                found.setdefault((base, name), []).extend(right)
    print("| base | adaptation | objects | recall at 1 | gained, points | ms per scene |")
    print("| --- | --- | --- | --- | --- | --- |")
    for (base, name), right in found.items():
        low, high = wilson_interval(sum(right), len(right))
        gained = paired_difference(right, found[base, "as it is"], scenes[base])
        interval = f"{100 * gained.mean:+.1f} [{100 * gained.interval[0]:+.1f}, {100 * gained.interval[1]:+.1f}]"
        share = f"{np.mean(right):.1%} [{low:.0%}, {high:.0%}]"
        cost = "" if name == "as it is" else f"{1000 * float(np.median(seconds[base, name])):.0f}"
        print(f"| {base} | {name} | {len(right)} | {share} | {interval if cost else ''} | {cost} |")


if __name__ == "__main__":
    main()
