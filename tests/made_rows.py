"""Rows as runs would leave them, for what is made of rows."""

from __future__ import annotations

import numpy as np

from toolkit.results.completion import MoveRow
from toolkit.results.rows import Row


def make_rows(cell, share, dataset="a", scenes=20, **fields):
    """Rows of an ablation, of which a share is right; the same objects in every cell."""
    rng = np.random.default_rng(0)
    rank = rng.permutation(scenes * 3)
    return [
        Row(
            cell=cell,
            settings={"pipeline.views": cell},
            dataset=dataset,
            scene_id=i // 3,
            scene=f"{i // 3:06d}",
            object=i % 3,
            object_name=f"object_{i % 7}",
            symmetry="none",
            **_outcome(bool(rank[i] < share * scenes * 3)),
            **fields,
        )
        for i in range(scenes * 3)
    ]


def _outcome(right):
    if not right:
        return {"status": "failed", "stage": "pnp", "reason": "too few inliers (5 among 12 matches, 8 needed) <b>&"}
    errors = {"rotation_error_deg": 1.0, "translation_error_cm": 0.5}
    symmetric = {f"{key}_sym": value for key, value in errors.items()}
    return {"status": "estimated", "success": True, "success_sym": True, **errors, **symmetric}


def make_move_rows(cell, share, **fields):
    """Rows of a rearrangement of which a share is right: 20 scenes of three objects, two rounds, a move an object."""
    about = ("cell", "settings", "dataset", "scene_id", "scene", "object", "object_name", "symmetry", "success")
    return [
        MoveRow(
            **{name: getattr(row, name) for name in (*about, "success_sym", "stage", "reason")},
            **{f"rotation_error_deg{kind}": 1.0 if row.success else 30.0 for kind in ("", "_sym")},
            **{f"translation_error_cm{kind}": 0.5 if row.success else 5.0 for kind in ("", "_sym")},
            right_after=[False, row.success],
            moves=1,
            buffer_moves=0,
            rounds=2,
            forced_buffers=0,
            scene_moves=3,
            time_ms={"perception": 1e3, "planning": 5.0},
            motion_s=20.0,
            ended={number: np.eye(4).tolist() for number in range(3)},
            **fields,
        )
        for row in make_rows(cell, share)
    ]
