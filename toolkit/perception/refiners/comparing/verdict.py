"""What refined hypotheses say together: the answer, what else it could be, and how sure that is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from toolkit.geometry import rotation_angle
from toolkit.perception.fusion import FusedModel, Start
from toolkit.perception.refiners.comparing.combine import agreeing
from toolkit.perception.refiners.comparing.compare import Hypothesis
from toolkit.perception.refiners.comparing.confidence import confidence
from toolkit.perception.refiners.comparing.likeness import unlikeness
from toolkit.types import Ambiguity

_SAME_OBJECT = 0.05
"""Motions after which less than this share of the surface has changed count as the same motion."""


@dataclass(frozen=True, eq=False)
class Verdict:
    """The answer for one object.

    Attributes:
        best: the hypothesis chosen.
        equivalents: all that agree with the goal image as well, `best` the first.
        ambiguity: what they are.
        confidence: 0..1, probability that `best` is right.
        supporters: starts that are `best`, found by another route.
    """

    best: Hypothesis
    equivalents: tuple[Hypothesis, ...]
    ambiguity: Ambiguity
    confidence: float
    supporters: tuple[Start, ...]


def judge(found: Sequence[Hypothesis], model: FusedModel, starts: Sequence[Start], same_score: float) -> Verdict:
    """Choose among hypotheses, best first.

    Of those that score as the best does and that nobody could tell from it, because the object is symmetric, the one
    that turns the object least is taken. Those that one could tell from it, were the other side in the picture, are not
    chosen over a better score, but stand among the equivalents.

    Args:
        found: refined hypotheses by falling score.
        model: the object.
        starts: what other routes found.
        same_score: scores this close to the best are as good.
    """
    unlike = unlikeness(model, [h.T_goal_current for h in found])
    close = [i for i, h in enumerate(found) if h.score >= found[0].score - same_score]
    twins = [i for i in close if unlike[i] < _SAME_OBJECT]
    best = min(twins, key=lambda i: rotation_angle(found[i].T_goal_current[:3, :3]))
    others = [i for i in close if i != best]
    hidden = len(twins) < len(close)
    supporters = agreeing(found[best].T_goal_current, model.center, starts)
    return Verdict(
        found[best],
        (found[best], *(found[i] for i in others)),
        "hidden" if hidden else "symmetric" if others else "none",
        confidence(found, unlike, supported=any(start.independent for start in supporters)),
        tuple(supporters),
    )
