"""What every matcher must do."""

from __future__ import annotations

from typing import Any

import numpy as np

from toolkit.plugin_kit.conformance.kit import Check, Subject, require, require_array, require_same_twice
from toolkit.plugin_kit.conformance.scene import blank_crop, crops
from toolkit.types import Crop, Matches

_CELL_PX = 8.0
"""How far a point may lie from itself: a coarse cell of detector-free matchers."""


def matches_lie_on_both_objects(subject: Subject) -> str:
    """One Matches per reference: (M, 2) float64 crop pixels (x, y) on both masks, (M,) scores in 0..1."""
    given, found = _match(subject)
    require(
        isinstance(found, list) and len(found) == len(given), f"match() must give one Matches for each of {len(given)}"
    )
    for matches, reference in zip(found, given, strict=True):
        require(isinstance(matches, Matches), f"match() must give Matches, got {type(matches).__name__}")
        for xy, crop, what in (
            (matches.query_xy, given[0], "query_xy"),
            (matches.reference_xy, reference, "reference_xy"),
        ):
            require_array(xy, (len(matches), 2), np.float64, what)
            _require_on(xy, crop, what)
        scores = require_array(matches.scores, (len(matches),), np.float64, "scores")
        require(((scores >= 0) & (scores <= 1)).all(), "scores must be in 0..1")
    return f"{len(found[0])} of an object to itself"


def a_crop_matches_itself_in_place(subject: Subject) -> None:
    """At least three matches, and half of them lie within 8 pixels of themselves."""
    matches = _match(subject)[1][0]
    require(len(matches) >= 3, f"a printed box gives only {len(matches)} matches to itself")
    off = float(np.median(np.linalg.norm(matches.query_xy - matches.reference_xy, axis=1)))
    require(off < _CELL_PX, f"a crop's points match points of itself that lie {off:.0f} pixels off (median)")


def a_batch_gives_what_single_pairs_give(subject: Subject) -> None:
    """A pair's matches do not depend on the other references."""
    matcher = subject.make()
    features = matcher.extract(_crops(matcher))
    together = matcher.match(features[0], features)
    for number, feature in enumerate(features):
        (alone,) = matcher.match(features[0], [feature])
        a, b = together[number], alone
        require(len(a) == len(b), f"reference {number} gives {len(a)} matches in a batch and {len(b)} alone")
        require(np.allclose(a.query_xy, b.query_xy, atol=0.05), f"reference {number} gives other matches in a batch")


def features_do_not_depend_on_the_other_crops(subject: Subject) -> None:
    """Extracted alone or with others, a crop's features match alike."""
    matcher = subject.make()
    given = _crops(matcher)[:2]
    together = matcher.extract(given)
    alone = [matcher.extract([crop])[0] for crop in given]
    (a,), (b,) = matcher.match(together[0], together[1:]), matcher.match(alone[0], alone[1:])
    require(abs(len(a) - len(b)) <= 0.02 * len(a) + 1, f"{len(a)} matches from one extract(), {len(b)} from two")


def a_blank_crop_matches_nothing(subject: Subject) -> None:
    """A black crop with one pixel of mask breaks nothing."""
    matcher = subject.make()
    features = matcher.extract([blank_crop(matcher.crop_size), _crops(matcher)[0]])
    most = max(len(matches) for matches in matcher.match(features[0], features))
    require(most <= 1, f"a blank crop has {most} matches")


def the_same_input_gives_the_same_bytes(subject: Subject) -> None:
    """New instances agree, whatever the global random generators are at."""
    require_same_twice(lambda: _match(subject)[1], "the list of matches")


def _crops(matcher: Any) -> list[Crop]:
    size = matcher.crop_size
    require(isinstance(size, int) and size > 0, f"crop_size must be a positive int, got {size!r}")
    return crops(size)


def _match(subject: Subject) -> tuple[list[Crop], Any]:
    """The first crop matched to all, itself the first."""
    matcher = subject.make()
    given = _crops(matcher)
    features = matcher.extract(given)
    require(len(features) == len(given), f"extract() gives {len(features)} features for {len(given)} crops")
    return given, matcher.match(features[0], features)


def _require_on(xy: np.ndarray, crop: Crop, what: str) -> None:
    size = crop.mask.shape[0]
    x, y = np.rint(xy).astype(int).T
    require(
        ((x >= 0) & (x < size) & (y >= 0) & (y < size)).all(), f"{what} leaves the crop: it is (x, y) in crop pixels"
    )
    off = int((~crop.mask[y, x]).sum())
    require(off == 0, f"{off} of {len(xy)} points of {what} lie beside the object's mask")


CHECKS: tuple[Check, ...] = (
    matches_lie_on_both_objects,
    a_crop_matches_itself_in_place,
    a_batch_gives_what_single_pairs_give,
    features_do_not_depend_on_the_other_crops,
    a_blank_crop_matches_nothing,
    the_same_input_gives_the_same_bytes,
)
