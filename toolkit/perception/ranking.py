"""Goal objects described and compared with the database: which region is tried first (Sec. Method A, retrieval)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from toolkit.perception.assignment import assign_instances, contenders, instance_similarity, restrict, true_instances
from toolkit.perception.crops import crop_region
from toolkit.perception.database import Database
from toolkit.perception.fusion import Models, RefineTask
from toolkit.perception.parts import Parts
from toolkit.perception.stages import AdaptiveDescriptor
from toolkit.types import Float, Frame, Segment


def rank(
    parts: Parts,
    database: Database,
    goal: Frame,
    segments: Sequence[Segment],
    models: Models,
    given: Sequence[int] | None = None,
) -> list[NDArray[np.int64]]:
    """Order the database by similarity, once for every goal object.

    Args:
        parts: the pipeline's.
        database: of the current scene, not empty.
        goal: the goal image.
        segments: Q objects in it, at least one.
        models: of the database's instances, for the refiner where it decides between instances that look alike.
        given: the Q instances that the objects are, where that is known.

    Returns:
        Q rankings: database rows by falling similarity. All rows, or those of the one instance that the object is or is
        assigned (`PipelineSettings.assignment`).
    """
    with parts.meter.stage("descriptor"):
        size, margin = parts.stages.descriptor.crop_size, parts.settings.crop_margin
        queries = parts.stages.descriptor.describe([crop_region(goal.rgb, s, size, margin) for s in segments])
        database, queries = _adapt(parts, database, queries)
    with parts.meter.stage("index"):
        parts.stages.index.build(database.descriptors)
        rankings = list(parts.stages.index.search(queries, len(database))[1])
    if given is not None:
        return [restrict(r, database.instances, i) for r, i in zip(rankings, given, strict=True)]
    if parts.settings.assignment == "vote":
        return rankings
    if parts.settings.assignment == "truth":
        chosen = true_instances(database, goal, segments)
    else:
        scores = instance_similarity(queries @ database.descriptors.T, database.instances)
        chosen = assign_instances(scores, _verify(parts, goal, segments, scores, models))
    return [restrict(r, database.instances, int(i)) for r, i in zip(rankings, chosen, strict=True)]


def _adapt(parts: Parts, database: Database, queries: Float) -> tuple[Database, Float]:
    """Database and queries as the descriptor sees them once it has learnt from the scene, where it can."""
    descriptor = parts.stages.descriptor
    if not isinstance(descriptor, AdaptiveDescriptor):
        return database, queries
    adaptation = descriptor.adapt(database.descriptors, database.instances)
    return replace(database, descriptors=adaptation(database.descriptors)), adaptation(queries)


def _verify(parts: Parts, goal: Frame, segments: Sequence[Segment], scores: Float, models: Models) -> Float:
    """(Q, K) how well instances that contend for a goal object agree with it, by the refiner; NaN elsewhere."""
    verified = np.full(scores.shape, np.nan)
    with parts.meter.stage("refiner"):
        for number, instance in np.argwhere(contenders(scores)):
            score = parts.stages.refiner.verify(RefineTask.of(goal, segments, number, int(instance), models))
            verified[number, instance] = np.nan if score is None else score
    return verified
