"""What a benchmark holds, how it was made, and its first scenes as one picture."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from toolkit.data.bop import load_capture
from toolkit.data.dataset import read_dataset
from toolkit.errors import ToolkitError
from toolkit.files import write_bytes
from toolkit.types import Capture, Image

_SHOWN = 6
_TILE_WIDTH_PX = 320


def describe(dataset: Path) -> Iterator[str]:
    """Yield one line per fact.

    Raises:
        ToolkitError: the folder is no dataset, or a capture cannot be read.
    """
    captures = read_dataset(dataset)
    made = dataset / "dataset.json"
    if made.exists():
        recipe = json.loads(made.read_text())
        yield f"made by {recipe['generator']} {recipe['toolkit']}, rendered by {recipe['renderer']}"
        # What is left to the track says nothing of its own.
        told = {key: value for key, value in recipe["config"].items() if value is not None}
        yield "settings: " + ", ".join(f"{key}={value}" for key, value in told.items())
    counts: Counter[int] = Counter()
    names: Counter[str] = Counter()
    only_current = only_goal = unknown = 0
    for folder in captures:
        capture = load_capture(folder)
        if capture.truth is None:
            unknown += 1
            continue
        counts[len(capture.truth)] += 1
        names.update(item.model.name for item in capture.truth.values())
        only_current += len(capture.only_current)
        only_goal += len(capture.only_goal)
    known = f"objects: {sum(names.values())}, {len(names)} different ones"
    yield f"captures: {len(captures)}" + (f"; {known}" if counts else "")
    if unknown:
        yield f"without truth, so that nobody knows their objects: {unknown}"
    if only_current or only_goal:
        yield f"objects in the current scene only: {only_current}; in the goal only: {only_goal}"
    if counts:
        yield "scenes by number of objects: " + ", ".join(f"{n}: {counts[n]}" for n in sorted(counts))


def contact_sheet(dataset: Path) -> Path:
    """Write DATASET/overview.png: goal, first and middle current frame of the first scenes, one scene per row.

    Raises:
        ToolkitError: the folder is no dataset or cannot be written.
    """
    rows = [_row(load_capture(folder)) for folder in read_dataset(dataset)[:_SHOWN]]
    path = dataset / "overview.png"
    try:
        write_bytes(path, cv2.imencode(".png", np.vstack(rows)[..., ::-1])[1].tobytes())
    except OSError as error:
        raise ToolkitError(f"'{path}' cannot be written: {error.strerror}") from error
    return path


def _row(capture: Capture) -> Image:
    frames = [capture.goal, capture.current[0], capture.current[len(capture.current) // 2]]
    tiles = [cv2.resize(f.rgb, (_TILE_WIDTH_PX, _TILE_WIDTH_PX * 3 // 4), interpolation=cv2.INTER_AREA) for f in frames]
    return np.hstack(tiles).astype(np.uint8)
