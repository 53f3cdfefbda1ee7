"""Draw the README's picture: what goes in, and where every object is to go.

toolkit dataset build captures --scenes 1 --seed 1 --set min_objects=7 --set max_objects=7
python experiments/figures/overview.py captures/000000 docs/images/overview.jpg
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from toolkit.data.bop import load_capture
from toolkit.harness.experiment import expand, load_experiment
from toolkit.harness.worker import make_runner
from toolkit.pictures.poses import overlay_picture


def main() -> None:
    """Estimate one capture with the shipped experiment `render_compare`, which is given the masks, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("out", type=Path)
    options = parser.parse_args()

    capture = load_capture(options.capture)
    pipeline = make_runner(expand(load_experiment("render_compare"))[0], cache=None).pipeline
    database = pipeline.build_database(capture.current)
    estimates = pipeline.estimate(database, capture.goal)

    figure, axes = plt.subplot_mosaic("abxyy\ncdxyy", figsize=(12.8, 5.0), width_ratios=[1, 1, 0.06, 1, 1])
    for name, index in zip("abcd", np.linspace(0, len(capture.current), 4, endpoint=False).astype(int), strict=True):
        axes[name].imshow(capture.current[index].rgb)
    axes["y"].imshow(overlay_picture(capture, database, estimates))
    for axis in axes.values():
        axis.axis("off")
    figure.subplots_adjust(0.005, 0.01, 0.995, 0.92, 0.015, 0.02)
    figure.text(0.245, 0.95, "now: posed RGB-D frames", ha="center", fontsize=15)
    figure.text(0.755, 0.95, "goal: one RGB image (masks given), and every place", ha="center", fontsize=15)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.out, dpi=110, pil_kwargs={"quality": 88})


if __name__ == "__main__":
    main()
