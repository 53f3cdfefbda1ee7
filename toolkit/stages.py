"""Every stage of the pipeline: its Protocol and its Registry. A stage never knows which neighbour it has."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from toolkit.fusion import RefineTask
from toolkit.moves import Finished, Grasp, MotionProblem, Move, Outcome, PickPlace, Table
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


class Registration(Protocol):
    """Corrects the poses of cameras by what their images show. Frames keep all but their camera's pose."""

    def register(self, frames: Sequence[Frame]) -> list[Frame]:
        """Return the current frames, RGB-D, with poses that agree with each other."""
        ...

    def locate(self, goal: Frame, frames: Sequence[Frame]) -> Frame:
        """Return the goal image, which has no depth, with a pose that agrees with the registered frames."""
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


Adaptation = Callable[[Float], Float]
"""Takes (N, d) descriptor rows to (N, d') float32 rows of unit length."""


@runtime_checkable
class AdaptiveDescriptor(Protocol):
    """What a Descriptor may offer besides: to learn from the scene at hand."""

    def adapt(self, rows: Float, instances: NDArray[np.int64]) -> Adaptation:
        """Learn from the database's (R, d) rows and their (R,) instances; the same input gives the same map.

        The map is applied to the database and to goal objects alike, before they are compared.
        """
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

    def verify(self, task: RefineTask) -> float | None:
        """Return how well the task's instance agrees with the goal object at its best, higher is better.

        Comparable between the instances and objects of one scene; None where this refiner does not compare images.
        """
        ...


class Schedule(Protocol):
    """The moves of one rearrangement, decided one at a time."""

    def next(self, table: Table) -> Move | Finished:
        """Return the next move from where things stand now, as they are seen or believed after the last move.

        Args:
            table: the same objects, in the same order, at every call.
        """
        ...


class Planner(Protocol):
    """Decides which object is moved where, and when (Sec. Method B)."""

    def start(self, seed: int) -> Schedule:
        """Begin a rearrangement. The same tables and seed give the same moves."""
        ...


class Grasper(Protocol):
    """Finds grasps on an object of which only points are known (Sec. Method B)."""

    def grasp(self, request: PickPlace, seed: int) -> list[Grasp] | Failure:
        """Return grasps that touch nothing else, neither here nor where the object is put; best first.

        A Failure says why there is none. The same request and seed give the same grasps.
        """
        ...


class Motion(Protocol):
    """Finds ways for an arm that touch nothing (Sec. Method B)."""

    def plan(self, problem: MotionProblem, seed: int) -> Float | Failure:
        """Return the (N, J) joint angles of a path, from start to goal, straight between its points.

        A Failure says why there is none. The same problem and seed give the same path.
        """
        ...


class Executor(Protocol):
    """Moves objects and looks at the table: a simulator, a robot, or a recording.

    Hardware implements the same six methods: `observe` drives a wrist camera to the predefined views, `pick_place`
    grasps the object whose points it is given, and what goes wrong comes back as an `Outcome`.
    """

    def begin(self, task: Any) -> Frame:
        """Take up a task and return its goal image.

        Args:
            task: for simulators a `toolkit.data.tabletop.TabletopScene`, whose objects they put on their table;
                others may ignore it.
        """
        ...

    def observe(self) -> list[Frame]:
        """Return RGB-D frames of the table as it is, from the predefined views, the home view first."""
        ...

    def pick_place(self, request: PickPlace) -> Outcome:
        """Pick one object up and put it down elsewhere. A failure is an Outcome, never an exception."""
        ...

    def home(self) -> None:
        """Move out of the cameras' sight."""
        ...

    def state(self) -> Mapping[int, Float] | None:
        """Return the true (4, 4) model-to-world poses by instance id where they are known; else None."""
        ...

    def close(self) -> None:
        """Let go of the task's resources."""
        ...


REGISTRATIONS: Registry[Registration] = Registry(
    "registration",
    "toolkit.registrations",
    {
        "none": "toolkit.registration.trusted:Trusted",
        "table": "toolkit.registration.table:TableRegistration",
    },
)
SEGMENTERS: Registry[Segmenter] = Registry(
    "segmenter",
    "toolkit.segmenters",
    {
        "oracle": "toolkit.segmenters.oracle:OracleSegmenter",
        "depth_plane": "toolkit.segmenters.depth_plane:DepthPlaneSegmenter",
        "grounded_sam": "toolkit.segmenters.grounded_sam:GroundedSamSegmenter",
        "mobile_sam": "toolkit.segmenters.mobile_sam:MobileSamSegmenter",
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
    {
        "sift": "toolkit.matchers.sift:SiftMatcher",
        "loftr": "toolkit.matchers.loftr:LoftrMatcher",
        "xfeat_lighterglue": "toolkit.matchers.xfeat_lighterglue:XFeatLighterGlue",
        "disk_lightglue": "toolkit.matchers.disk_lightglue:DiskLightGlue",
        "aliked_lightglue": "toolkit.matchers.aliked_lightglue:AlikedLightGlue",
    },
)
PNP: Registry[PnP] = Registry(
    "pnp",
    "toolkit.pnp",
    {
        "opencv_epnp": "toolkit.pnp.opencv:OpenCVEPnP",
        "opencv_sqpnp": "toolkit.pnp.opencv:OpenCVSQPnP",
        "poselib": "toolkit.pnp.poselib:PoseLib",
        "jax_ransac": "toolkit.pnp.jax_ransac:JaxRansac",
        "jax_joint": "toolkit.pnp.jax_joint:JaxJoint",
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

PLANNERS: Registry[Planner] = Registry(
    "planner",
    "toolkit.planners",
    {"paper": "toolkit.planners.paper:Paper", "optimal": "toolkit.planners.optimal:Optimal"},
)
GRASPERS: Registry[Grasper] = Registry(
    "grasp",
    "toolkit.grasps",
    {
        "antipodal": "toolkit.grasps.antipodal:Antipodal",
        "contact_graspnet": "toolkit.grasps.contact_graspnet:ContactGraspnet",
    },
)
MOTION: Registry[Motion] = Registry("motion", "toolkit.motion", {"ompl": "toolkit.motion.ompl:Ompl"})
EXECUTORS: Registry[Executor] = Registry(
    "executor",
    "toolkit.executors",
    {
        "arm": "toolkit.executors.arm:Arm",
        "kinematic": "toolkit.executors.kinematic:Kinematic",
        "replay": "toolkit.executors.replay:Replay",
    },
)

REGISTRIES: dict[str, Registry[Any]] = {
    registry.stage: registry
    for registry in (
        REGISTRATIONS,
        SEGMENTERS,
        ASSOCIATORS,
        DESCRIPTORS,
        INDEXES,
        RETRIEVERS,
        MATCHERS,
        PNP,
        REFINERS,
        PLANNERS,
        GRASPERS,
        MOTION,
        EXECUTORS,
    )
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
