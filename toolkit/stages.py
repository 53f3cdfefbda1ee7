"""Every stage of the pipeline: its Protocol and its Registry. A stage never knows which neighbour it has."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from toolkit.fusion import RefineTask
from toolkit.registry import Plugin, Registry
from toolkit.types import (
    Correspondences,
    Crop,
    Failure,
    Float,
    Frame,
    Matches,
    PnPSolution,
    Refined,
    Region,
    Segment,
)


class Segmenter(Protocol):
    """Finds objects in one image."""

    def segment(self, frame: Frame, current: Sequence[Frame]) -> list[Segment]:
        """Return one Segment an object, masks disjoint, in a deterministic order.

        Args:
            frame: the image to segment; the goal image has no depth.
            current: all RGB-D frames of the current scene, for segmenters that learn the table from them.

        Raises:
            ToolkitError: the frame lacks what this segmenter needs (depth, truth).
        """
        ...


class Associator(Protocol):
    """Groups regions of several frames into object instances (Sec. Method A)."""

    def associate(self, regions: Sequence[Region], frames: Sequence[Frame]) -> NDArray[np.int64]:
        """Return (R,) int64 instance ids 0..K-1, one a region; every id in that range occurs."""
        ...


class Descriptor(Protocol):
    """Describes crops by vectors whose inner product is their similarity (Eq. global_description)."""

    crop_size: int
    """Side of the square crops it wants, pixels."""

    def describe(self, crops: Sequence[Crop]) -> Float:
        """Return (N, d) float32 rows of unit length, for N >= 1 crops."""
        ...


class Index(Protocol):
    """Maximum inner-product search."""

    def build(self, vectors: Float) -> None:
        """Take (N, d) float32 vectors as the database, replacing what was there."""
        ...

    def search(self, queries: Float, k: int) -> tuple[Float, NDArray[np.int64]]:
        """Return (Q, k') float32 scores in falling order and (Q, k') int64 rows, k' = min(k, N)."""
        ...


class Traversal(Protocol):
    """The order in which one goal object's candidates are tried."""

    def next(self, n: int) -> list[int]:
        """Return up to n further candidate regions (database rows), best first; empty when none is left."""
        ...

    def reject(self, region: int) -> None:
        """Say that a candidate did not match, so that candidates like it can be skipped."""
        ...


class Retriever(Protocol):
    """Turns a similarity ranking into candidates (Sec. Method A, retrieval phase)."""

    def start(self, ranking: NDArray[np.int64], instances: NDArray[np.int64], observations: Float) -> Traversal:
        """Begin the traversal for one goal object.

        Args:
            ranking: (R,) database rows by falling similarity to the goal object.
            instances: (R,) instance id of every database row.
            observations: (R, 3) observation vector of every database row (Eq. obs_pose).
        """
        ...


class Matcher(Protocol):
    """Finds pixel correspondences between two crops (Eq. 2D_match)."""

    crop_size: int
    """Side of the square crops it wants, pixels."""

    def extract(self, crops: Sequence[Crop]) -> list[Any]:
        """Return one opaque feature value a crop; computed once and used in every `match` the crop is part of."""
        ...

    def match(self, query: Any, references: Sequence[Any]) -> list[Matches]:
        """Match one goal crop's features to several candidates' features, in one batch; one Matches each."""
        ...


class PnP(Protocol):
    """Solves an object's pose from 2D-3D correspondences, rejecting outliers."""

    def solve(self, problem: Correspondences, seed: int) -> PnPSolution | Failure:
        """Return the pose, or a Failure with its reason. The same problem and seed give the same bytes."""
        ...


class Refiner(Protocol):
    """Improves and verifies an object's motion by comparing its fused model with the goal image."""

    def refine(self, task: RefineTask) -> Refined | Failure | None:
        """Return the verified motion, an Abstention where it is not believed, a Failure where there is none.

        None leaves the task's first start as it is.
        """
        ...


SEGMENTERS: Registry[Segmenter] = Registry(
    "segmenter",
    "toolkit.segmenters",
    {
        "oracle": "toolkit.segmenters.oracle:OracleSegmenter",
        "depth_plane": "toolkit.segmenters.depth_plane:DepthPlaneSegmenter",
        "table_appearance": "toolkit.segmenters.table_appearance:TableAppearanceSegmenter",
    },
)
ASSOCIATORS: Registry[Associator] = Registry(
    "associator",
    "toolkit.associators",
    {
        "oracle": "toolkit.associators.oracle:OracleAssociator",
        "kmeans": "toolkit.associators.kmeans:KMeansAssociator",
    },
)
DESCRIPTORS: Registry[Descriptor] = Registry(
    "descriptor",
    "toolkit.descriptors",
    {
        "color_hist": "toolkit.descriptors.color_hist:ColorHistogram",
        "hog": "toolkit.descriptors.hog:Hog",
        "gem": "toolkit.descriptors.gem:Gem",
        "mixvpr": "toolkit.descriptors.mixvpr:Mixvpr",
    },
)
INDEXES: Registry[Index] = Registry(
    "index",
    "toolkit.indexes",
    {"faiss": "toolkit.indexes.faiss_flat:FaissIndex", "numpy": "toolkit.indexes.numpy_exact:NumpyIndex"},
)
RETRIEVERS: Registry[Retriever] = Registry(
    "retriever",
    "toolkit.retrievers",
    {
        "instance_vote": "toolkit.retrieval.instance_vote:InstanceVote",
        "brute_force": "toolkit.retrieval.brute_force:BruteForce",
    },
)
MATCHERS: Registry[Matcher] = Registry(
    "matcher",
    "toolkit.matchers",
    {"sift": "toolkit.matchers.sift:SiftMatcher", "loftr": "toolkit.matchers.loftr:LoftrMatcher"},
)
PNP: Registry[PnP] = Registry(
    "pnp",
    "toolkit.pnp",
    {
        "opencv_epnp": "toolkit.pnp.opencv:OpenCVEPnP",
        "opencv_sqpnp": "toolkit.pnp.opencv:OpenCVSQPnP",
        "poselib": "toolkit.pnp.poselib:PoseLib",
        "jax_ransac": "toolkit.pnp.jax_ransac:JaxRansac",
    },
)
REFINERS: Registry[Refiner] = Registry(
    "refiner",
    "toolkit.refiners",
    {
        "none": "toolkit.refiners.unrefined:Unrefined",
        "photometric": "toolkit.refiners.photometric:Photometric",
        "render_compare": "toolkit.refiners.render_compare:RenderCompare",
    },
)

REGISTRIES: dict[str, Registry[Any]] = {
    registry.stage: registry
    for registry in (SEGMENTERS, ASSOCIATORS, DESCRIPTORS, INDEXES, RETRIEVERS, MATCHERS, PNP, REFINERS)
}
"""Singular stage name -> registry, in pipeline order."""


def register_module(module: Any, origin: str) -> int:
    """Register every plugin class of a module that defines `stage` and `name`; returns how many."""
    count = 0
    for value in vars(module).values():
        is_plugin = isinstance(value, type) and issubclass(value, Plugin) and value.__module__ == module.__name__
        if is_plugin and getattr(value, "stage", None) in REGISTRIES:
            REGISTRIES[value.stage].register(value, origin)
            count += 1
    return count
