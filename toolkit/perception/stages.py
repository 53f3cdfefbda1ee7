"""The perception module's stages (Sec. Method A): a Protocol and a Registry for each."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from toolkit.perception.explanation import ExplainTask, Explanation
from toolkit.perception.fusion import RefineTask
from toolkit.registry import Registry
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

    @abstractmethod
    def segment(self, frame: Frame, current: Sequence[Frame]) -> list[Segment]:
        """Return one Segment an object, masks disjoint, in a deterministic order.

        Args:
            frame: the image to segment; the goal image has no depth.
            current: all RGB-D frames of the current scene, for segmenters that learn the table from them.

        Raises:
            ToolkitError: the frame lacks what this segmenter needs (depth, truth).
        """
        ...


class Registration(Protocol):
    """Corrects the poses of cameras by what their images show. Frames keep all but their camera's pose."""

    @abstractmethod
    def register(self, frames: Sequence[Frame]) -> list[Frame]:
        """Return the current frames, RGB-D, with poses that agree with each other."""
        ...

    @abstractmethod
    def locate(self, goal: Frame, frames: Sequence[Frame]) -> Frame:
        """Return the goal image, which has no depth, with a pose that agrees with the registered frames."""
        ...


class Associator(Protocol):
    """Groups regions of several frames into object instances (Sec. Method A)."""

    @abstractmethod
    def associate(self, regions: Sequence[Region], frames: Sequence[Frame]) -> NDArray[np.int64]:
        """Return (R,) int64 instance ids 0..K-1, one per region; every id in that range occurs."""
        ...


class Explainer(Protocol):
    """Says what the goal image shows in terms of the current scene's instances, before any mask is final."""

    @abstractmethod
    def explain(self, task: ExplainTask) -> Explanation | None:
        """Return which instances stand where in the goal image, and what is none of them.

        None leaves the goal's objects to the goal segmenter, and which instances they are to retrieval (the paper).

        Raises:
            ToolkitError: the scene lacks what this explainer needs (a table in the depth of the current frames).
        """
        ...


class Descriptor(Protocol):
    """Describes crops by vectors whose inner product is their similarity (Eq. global_description)."""

    @property
    @abstractmethod
    def crop_size(self) -> int:
        """Side of the square crops it wants, pixels."""
        ...

    @abstractmethod
    def describe(self, crops: Sequence[Crop]) -> Float:
        """Return (N, d) float32 rows of unit length, for N >= 1 crops."""
        ...


Adaptation = Callable[[Float], Float]
"""Takes (N, d) descriptor rows to (N, d') float32 rows of unit length."""


@runtime_checkable
class AdaptiveDescriptor(Protocol):
    """What a Descriptor may offer besides: to learn from the scene at hand."""

    @abstractmethod
    def adapt(self, rows: Float, instances: NDArray[np.int64]) -> Adaptation:
        """Learn from the database's (R, d) rows and their (R,) instances; the same input gives the same map.

        The map is applied to the database and to goal objects alike, before they are compared.
        """
        ...


class Index(Protocol):
    """Maximum inner-product search."""

    @abstractmethod
    def build(self, vectors: Float) -> None:
        """Take (N, d) float32 vectors as the database, replacing what was there."""
        ...

    @abstractmethod
    def search(self, queries: Float, k: int) -> tuple[Float, NDArray[np.int64]]:
        """Return (Q, k') float32 scores in falling order and (Q, k') int64 rows, k' = min(k, N)."""
        ...


class Traversal(Protocol):
    """The order in which one goal object's candidates are tried."""

    @abstractmethod
    def next(self, n: int) -> list[int]:
        """Return up to n further candidate regions (database rows), best first; empty when none is left."""
        ...

    @abstractmethod
    def reject(self, region: int) -> None:
        """Say that a candidate did not match, so that candidates like it can be skipped."""
        ...


class Retriever(Protocol):
    """Turns a similarity ranking into candidates (Sec. Method A, retrieval phase)."""

    @abstractmethod
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

    @property
    @abstractmethod
    def crop_size(self) -> int:
        """Side of the square crops it wants, pixels."""
        ...

    @abstractmethod
    def extract(self, crops: Sequence[Crop]) -> list[Any]:
        """Return one opaque feature value per crop; computed once and used in every `match` the crop is part of."""
        ...

    @abstractmethod
    def match(self, query: Any, references: Sequence[Any]) -> list[Matches]:
        """Match one goal crop's features to several candidates' features, in one batch; one Matches each."""
        ...


class PnP(Protocol):
    """Solves an object's pose from 2D-3D correspondences, rejecting outliers."""

    @abstractmethod
    def solve(self, problem: Correspondences, seed: int) -> PnPSolution | Failure:
        """Return the pose, or a Failure with its reason. The same problem and seed give the same bytes."""
        ...


class Refiner(Protocol):
    """Improves and verifies an object's motion by comparing its fused model with the goal image."""

    @abstractmethod
    def refine(self, task: RefineTask) -> Refined | Failure | None:
        """Return the verified motion, an Abstention where it is not believed, a Failure where there is none.

        None leaves the task's first start as it is.
        """
        ...

    @abstractmethod
    def verify(self, task: RefineTask) -> float | None:
        """Return how well the task's instance agrees with the goal object at its best, higher is better.

        Comparable between the instances and objects of one scene; None where this refiner does not compare images.
        """
        ...


REGISTRATIONS: Registry[Registration] = Registry(
    "registration",
    "toolkit.registrations",
    {
        "gicp": "toolkit.perception.registration.gicp:Gicp",
        "none": "toolkit.perception.registration.none:Trusted",
        "table": "toolkit.perception.registration.table:TableRegistration",
    },
)
SEGMENTERS: Registry[Segmenter] = Registry(
    "segmenter",
    "toolkit.segmenters",
    {
        "oracle": "toolkit.perception.segmenters.oracle:OracleSegmenter",
        "depth_plane": "toolkit.perception.segmenters.depth_plane:DepthPlaneSegmenter",
        "grounded_sam": "toolkit.perception.segmenters.grounded_sam:GroundedSamSegmenter",
        "masks": "toolkit.perception.segmenters.masks:MasksSegmenter",
        "mobile_sam": "toolkit.perception.segmenters.mobile_sam:MobileSamSegmenter",
        "multiview": "toolkit.perception.segmenters.multiview:MultiviewSegmenter",
        "table_appearance": "toolkit.perception.segmenters.table_appearance:TableAppearanceSegmenter",
    },
)
ASSOCIATORS: Registry[Associator] = Registry(
    "associator",
    "toolkit.associators",
    {
        "oracle": "toolkit.perception.associators.oracle:OracleAssociator",
        "kmeans": "toolkit.perception.associators.kmeans:KMeansAssociator",
        "overlap": "toolkit.perception.associators.overlap:OverlapAssociator",
    },
)
EXPLAINERS: Registry[Explainer] = Registry(
    "explainer",
    "toolkit.explainers",
    {
        "none": "toolkit.perception.explainers.none:Unexplained",
        "perch": "toolkit.perception.explainers.perch:Perch",
    },
)
DESCRIPTORS: Registry[Descriptor] = Registry(
    "descriptor",
    "toolkit.descriptors",
    {
        "color_hist": "toolkit.perception.descriptors.color_hist:ColorHistogram",
        "hog": "toolkit.perception.descriptors.hog:Hog",
        "gem": "toolkit.perception.descriptors.gem:Gem",
        "mixvpr": "toolkit.perception.descriptors.mixvpr:Mixvpr",
    },
)
INDEXES: Registry[Index] = Registry(
    "index",
    "toolkit.indexes",
    {"faiss": "toolkit.perception.indexes.faiss:FaissIndex", "numpy": "toolkit.perception.indexes.numpy:NumpyIndex"},
)
RETRIEVERS: Registry[Retriever] = Registry(
    "retriever",
    "toolkit.retrievers",
    {
        "instance_vote": "toolkit.perception.retrieval.instance_vote:InstanceVote",
        "brute_force": "toolkit.perception.retrieval.brute_force:BruteForce",
    },
)
MATCHERS: Registry[Matcher] = Registry(
    "matcher",
    "toolkit.matchers",
    {
        "sift": "toolkit.perception.matchers.sift:SiftMatcher",
        "loftr": "toolkit.perception.matchers.loftr:LoftrMatcher",
        "xfeat_lighterglue": "toolkit.perception.matchers.xfeat_lighterglue:XFeatLighterGlue",
        "xfeat_star": "toolkit.perception.matchers.xfeat_star:XFeatStar",
        "disk_lightglue": "toolkit.perception.matchers.disk_lightglue:DiskLightGlue",
        "aliked_lightglue": "toolkit.perception.matchers.aliked_lightglue:AlikedLightGlue",
    },
)
PNP: Registry[PnP] = Registry(
    "pnp",
    "toolkit.pnp",
    {
        "opencv_epnp": "toolkit.perception.pnp.opencv_epnp:OpenCVEPnP",
        "opencv_sqpnp": "toolkit.perception.pnp.opencv_sqpnp:OpenCVSQPnP",
        "poselib": "toolkit.perception.pnp.poselib:PoseLib",
        "jax_ransac": "toolkit.perception.pnp.jax_ransac:JaxRansac",
        "jax_joint": "toolkit.perception.pnp.jax_joint:JaxJoint",
    },
)
REFINERS: Registry[Refiner] = Registry(
    "refiner",
    "toolkit.refiners",
    {
        "none": "toolkit.perception.refiners.none:Unrefined",
        "onepose": "toolkit.perception.refiners.onepose:OnePose",
        "photometric": "toolkit.perception.refiners.photometric:Photometric",
        "render_compare": "toolkit.perception.refiners.render_compare:RenderCompare",
    },
)
