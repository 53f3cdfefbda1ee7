"""How likely an answer is right, from how well it agrees with the goal image and how far it leads."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from toolkit.perception.refiners.comparing.compare import Hypothesis
from toolkit.types import Float

_WEIGHTS = np.array([1.922, 3.001, -1.439, -1.395, 1.735, 3.113])
_BIAS = -0.989
"""Logistic regression on 150 scenes of procedural objects (experiments/benchmarks/confidence.py)."""

_MOST_LEAD = 0.5


def features(found: Sequence[Hypothesis], unlike: Float, *, supported: bool) -> Float:
    """What the best of ordered hypotheses is judged by.

    Args:
        found: hypotheses by falling score.
        unlike: (len(found),) how much each differs from the best in what all sides of the object show (`likeness`).
        supported: whether another route, PnP on matches, led to the same motion.

    Returns:
        (6,) agreement of colours and of intensities, contrast, how far the model lies beside the object, lead over the
        next hypothesis, greater where that is hardly another one, and 1 for support.
    """
    best = found[0]
    leads = [
        best.score - h.score + _MOST_LEAD * (1 - min(2 * u, 1)) for h, u in zip(found[1:], unlike[1:], strict=True)
    ]
    return np.array(
        [
            best.known * best.correlation,
            best.known * best.photometric,
            best.known * best.color,
            np.log1p(best.spill_px),
            min([_MOST_LEAD, *leads]),
            float(supported),
        ]
    )


def confidence(found: Sequence[Hypothesis], unlike: Float, *, supported: bool) -> float:
    """Probability 0..1 that the best hypothesis is within 5 deg and 2 cm of the truth; arguments as `features`."""
    return float(1 / (1 + np.exp(-(features(found, unlike, supported=supported) @ _WEIGHTS + _BIAS))))
