"""Rows as an ablation would leave them, for what is made of rows."""

from __future__ import annotations

import numpy as np

from toolkit.results.rows import Row


def make_rows(cell, share, dataset="a", scenes=20, **fields):
    """Rows of which a share is right, the same objects in every cell."""
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
        return {"status": "failed", "stage": "pnp", "reason": "5 inliers of 12, at least 8 are needed <b>&"}
    errors = {"rotation_error_deg": 1.0, "translation_error_cm": 0.5}
    symmetric = {f"{key}_sym": value for key, value in errors.items()}
    return {"status": "estimated", "success": True, "success_sym": True, **errors, **symmetric}
