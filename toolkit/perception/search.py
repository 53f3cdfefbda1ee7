"""A goal object's candidates matched in the retriever's order, until enough are accepted (Sec. Method A)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from toolkit.perception.crops import crop_region
from toolkit.perception.database import Database
from toolkit.perception.lifting import lift_matches
from toolkit.perception.parts import Parts
from toolkit.perception.stages import Matcher
from toolkit.types import Correspondences, Crop, Frame, PnPSolution, Segment


class References:
    """Candidate crops and features of one database, made when first asked for and kept for every goal object."""

    def __init__(self, database: Database, matcher: Matcher, crop_margin: float) -> None:
        self.database = database
        self.crops: dict[int, Crop] = {}
        self._features: dict[int, object] = {}
        self._matcher = matcher
        self._crop_margin = crop_margin

    def features(self, rows: Sequence[int]) -> list[object]:
        """The matcher's features of regions `rows`, extracting the missing ones in one batch."""
        missing = [row for row in rows if row not in self._features]
        if missing:
            for row in missing:
                rgb, segment = self.database.frame_of(row).rgb, self.database.regions[row].segment
                self.crops[row] = crop_region(rgb, segment, self._matcher.crop_size, self._crop_margin)
            extracted = self._matcher.extract([self.crops[row] for row in missing])
            self._features.update(zip(missing, extracted, strict=True))
        return [self._features[row] for row in rows]


@dataclass(frozen=True)
class Accepted:
    """A candidate that has enough lifted matches.

    Attributes:
        row: its database row.
        correspondences: its matches, lifted.
    """

    row: int
    correspondences: Correspondences


@dataclass
class Search:
    """What trying one goal object's candidates has found.

    Attributes:
        accepted: the candidates accepted, in the order in which they were tried.
        first: database row of the first candidate, or None where there was none.
        matcher_calls: candidates matched.
        most_matches: lifted matches of the best candidate, accepted or not.
    """

    accepted: list[Accepted] = field(default_factory=list[Accepted])
    first: int | None = None
    matcher_calls: int = 0
    most_matches: int = 0


def search_candidates(
    parts: Parts, references: References, goal: Frame, segment: Segment, ranking: NDArray[np.int64]
) -> Search:
    """Try candidates in the retriever's order; stop at the first accepted one when `fuse` is `first`.

    Args:
        parts: the pipeline's.
        references: the database, with what is known of its regions' features.
        goal: the goal image.
        segment: the object in it.
        ranking: database rows by falling similarity to it.
    """
    database, found = references.database, Search()
    with parts.meter.stage("retriever"):
        traversal = parts.stages.retriever.start(ranking, database.instances, database.observations)
    query_crop = crop_region(goal.rgb, segment, parts.stages.matcher.crop_size, parts.settings.crop_margin)
    with parts.meter.stage("matcher"):
        query = parts.stages.matcher.extract([query_crop])[0]
    batch = 1 if parts.settings.fuse == "first" else len(database)
    while rows := traversal.next(batch):
        found.first = rows[0] if found.first is None else found.first
        with parts.meter.stage("matcher"):
            matches = parts.stages.matcher.match(query, references.features(rows))
        found.matcher_calls += len(rows)
        for row, pairs in zip(rows, matches, strict=True):
            mask = database.regions[row].segment.mask
            lifted = lift_matches(pairs, query_crop, references.crops[row], database.frame_of(row), mask, goal.camera)
            found.most_matches = max(found.most_matches, len(lifted))
            if len(lifted) >= parts.settings.min_matches and _acceptable(parts, lifted):
                found.accepted.append(Accepted(row, lifted))
            else:
                traversal.reject(row)
        if parts.settings.fuse == "first" and found.accepted:
            break
    return found


def _acceptable(parts: Parts, lifted: Correspondences) -> bool:
    """With `first`, a candidate whose matches admit no pose is rejected, and the traversal goes on."""
    if parts.settings.fuse == "all":
        return True
    with parts.meter.stage("pnp"):
        return isinstance(parts.stages.pnp.solve(lifted, parts.seed), PnPSolution)
