"""What a scene of every track costs: processor time to draw it, to open it and per picture, side by side.

python experiments/benchmarks/rendering.py --scenes 5

Processor time of this process, so that what else the machine does counts little; with EGL's software driver it includes
the driver's threads.
"""

from __future__ import annotations

import argparse
import time
from typing import get_args

import numpy as np

from toolkit.data.conditions import Track
from toolkit.data.dataset import object_set
from toolkit.data.scene import TabletopConfig, draw_scene
from toolkit.data.tabletop import Studio
from toolkit.paths import cache_root
from toolkit.sim.bullet import Renderer, best_renderer


def cost(track: Track, number: int, renderer: Renderer) -> tuple[float, float, float]:
    """Milliseconds of processor time: to draw scene `number`, to open it, per picture."""
    config = TabletopConfig(track=track, views=4, min_objects=5, max_objects=5, renderer=renderer, seed=1)
    objects = object_set(config.objects, cache_root())
    times = [time.process_time()]
    scene = draw_scene(config, objects, number, cache_root())
    times.append(time.process_time())
    with Studio(scene, cache_root()) as studio:
        times.append(time.process_time())
        pictures = [studio.goal(), *studio.current(scene.current)]
        times.append(time.process_time())
    draw, opened, rendered = (1e3 * float(t) for t in np.diff(times))
    return draw, opened, rendered / len(pictures)


def main() -> None:
    """Measure every track."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=5)
    parser.add_argument("--renderer", choices=get_args(Renderer), default=best_renderer())
    options = parser.parse_args()
    for number in range(options.scenes):  # how objects rest is worked out once
        cost("clean", number, options.renderer)
    print("| track | ms to draw a scene | ms to open it | ms per picture | times clean |")
    print("| --- | --- | --- | --- | --- |")
    plain = 0.0
    for track in get_args(Track):
        costs = [cost(track, number, options.renderer) for number in range(options.scenes)]
        draw, opened, picture = np.median(costs, axis=0).tolist()
        plain = plain or picture
        print(f"| {track} | {draw:.0f} | {opened:.0f} | {picture:.0f} | {picture / plain:.1f} |")


if __name__ == "__main__":
    main()
