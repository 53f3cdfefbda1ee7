"""How likely an answer is right, from how well it agrees with the goal image and how far it leads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolkit.refiners.compare import Hypothesis
from toolkit.types import Float

_WEIGHTS = np.array([0.730, 2.177, 5.233, -1.431, 3.056])
_BIAS = -3.937
"""Logistic regression on 60 scenes of procedural objects (experiments/benchmarks/confidence.py)."""


def features(found: Sequence[Hypothesis]) -> Float:
    """(5,) what the best of ordered hypotheses is judged by: overlap, colours, intensities, contrast, lead."""
    best = found[0]
    lead = best.score - found[1].score if len(found) > 1 else 1.0
    return np.array([best.iou, best.correlation, best.photometric, best.color, min(lead, 1.0)])


def confidence(found: Sequence[Hypothesis]) -> float:
    """Probability 0..1 that the best hypothesis is within 5 deg and 2 cm of the truth."""
    return float(1 / (1 + np.exp(-(features(found) @ _WEIGHTS + _BIAS))))
