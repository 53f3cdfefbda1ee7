"""What other tools make of the files that are exported."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from toolkit.geometry import make_transform
from toolkit.types import Float


def rows_of(path: Path) -> list[dict[str, Any]]:
    """The rows of a CSV of the BOP challenge; R is (3, 3), t (3,) in millimetres."""
    with path.open() as file:
        lines = list(csv.DictReader(file))
    assert list(lines[0]) == ["scene_id", "im_id", "obj_id", "score", "R", "t", "time"]
    numbers = {"scene_id": int, "im_id": int, "obj_id": int, "score": float, "time": float}
    found = [{key: kind(line[key]) for key, kind in numbers.items()} for line in lines]
    for row, line in zip(found, lines, strict=True):
        row["R"] = np.array(line["R"].split(" "), np.float64).reshape(3, 3)
        row["t"] = np.array(line["t"].split(" "), np.float64)
    return found


def transform_of(stamped: dict[str, Any], frame: str = "base_link") -> Float:
    """(4, 4) of a PoseStamped in `frame`."""
    assert stamped["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": frame}
    at, turn = stamped["pose"]["position"], stamped["pose"]["orientation"]
    R = Rotation.from_quat([turn[axis] for axis in "xyzw"]).as_matrix()
    return make_transform(R, np.array([at[axis] for axis in "xyz"]))
