"""Draw one picture of every track: the goal image, a current frame and its depth.

python experiments/figures/tracks.py docs/images/tracks
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from toolkit.data.dataset import object_set
from toolkit.data.scene import TabletopConfig, draw_scene
from toolkit.data.tabletop import Studio
from toolkit.paths import cache_root
from toolkit.types import Float, Image

SHOWN: dict[str, tuple[int, dict[str, Any]]] = {
    "clean": (3, {}),
    "d435": (3, {}),
    "realsense": (3, {"background": True, "shadows": True}),
    "kinect": (3, {"background": True, "shadows": True}),
    "crowded": (3, {}),
    "wild": (8, {}),
}
"""By track, the scene that is drawn, and settings that show more of it."""

_WIDTH_PX, _HEIGHT_PX = 320, 240
_NEAREST_M, _FURTHEST_M = 0.5, 2.6


def picture(track: str, number: int, settings: dict[str, Any]) -> Image:
    """Goal, frame and depth side by side, (H, W, 3) uint8 BGR."""
    config = TabletopConfig.model_validate({"track": track, "seed": 5, "min_objects": 6, "views": 3, **settings})
    scene = draw_scene(config, object_set(config.objects, cache_root()), number, cache_root())
    with Studio(scene, cache_root()) as studio:
        goal, frame = studio.goal(), studio.current(scene.current)[-1]
    assert frame.depth is not None
    tiles = [goal.rgb[..., ::-1], frame.rgb[..., ::-1], colored(frame.depth)]
    size = (_WIDTH_PX, _HEIGHT_PX)
    return np.hstack([cv2.resize(np.ascontiguousarray(t), size, interpolation=cv2.INTER_AREA) for t in tiles])


def colored(depth: Float) -> Image:
    """Depth as colours, black where nothing was measured; (H, W, 3) uint8 BGR."""
    share = (depth - _NEAREST_M) / (_FURTHEST_M - _NEAREST_M)
    image = cv2.applyColorMap((255 * share.clip(0, 1)).astype(np.uint8), cv2.COLORMAP_TURBO)
    image[depth == 0] = 0
    return np.asarray(image, np.uint8)


def main() -> None:
    """Draw every track into a folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for track, (number, settings) in SHOWN.items():
        path = options.out / f"{track}.jpg"
        cv2.imwrite(str(path), picture(track, number, settings), [cv2.IMWRITE_JPEG_QUALITY, 82])
        print(path)


if __name__ == "__main__":
    main()
