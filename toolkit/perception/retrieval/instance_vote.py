"""The paper's retrieval: the instance most frequent among the top-ranked regions gives the candidates."""

from __future__ import annotations

from collections import Counter
from math import radians
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from toolkit.perception.retrieval.candidates.distance import geodesic_distance, paper_distance
from toolkit.perception.retrieval.candidates.traversal import PrunedTraversal
from toolkit.perception.stages import Retriever
from toolkit.registry import Plugin, PluginConfig
from toolkit.types import Float


class InstanceVoteConfig(PluginConfig):
    """Settings of `instance_vote`."""

    top_k: int = Field(5, ge=1, description="Number of top-ranked regions that vote for their instance.")
    max_instances: int = Field(
        2,
        ge=1,
        description="Number of instances with the most votes whose regions become candidates; the paper takes 1.",
    )
    max_candidates: int = Field(64, ge=1, description="Largest number of candidates that are tried.")
    distance: Literal["geodesic", "paper"] = Field(
        "geodesic",
        description="How the angle between observation vectors is computed: as printed in the paper, or as the true "
        "angle.",
    )
    prune_deg: float = Field(
        20.0,
        ge=0,
        le=180,
        description="Candidates whose view is closer than this to a rejected one's are deleted; 0 deletes none.",
    )


class InstanceVote(Plugin[InstanceVoteConfig], Retriever):
    """Instance voting and angular pruning (Sec. Method A, retrieval phase).

    All regions of the winning instance are candidates, in the order of their similarity. A tie goes to the instance
    whose best region ranks first. With `distance: paper` the pruning uses Eq. obs_pose_distance as printed.
    """

    stage = "retriever"
    name = "instance_vote"

    def start(self, ranking: NDArray[np.int64], instances: NDArray[np.int64], observations: Float) -> PrunedTraversal:
        """Vote and return the traversal of the winners' regions."""
        voters = instances[ranking[: self.config.top_k]].tolist()
        # Counter keeps the order of first occurrence among equals, which is the order of rank.
        winners = [instance for instance, _ in Counter(voters).most_common(self.config.max_instances)]
        order = [int(row) for winner in winners for row in ranking[instances[ranking] == winner]]
        return PrunedTraversal(
            order[: self.config.max_candidates],
            lambda a, b: bool(instances[a] == instances[b]),
            observations,
            paper_distance if self.config.distance == "paper" else geodesic_distance,
            radians(self.config.prune_deg),
        )
