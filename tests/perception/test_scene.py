"""What becomes of the stages' answers: which regions are ranked, whose motion wins, what the refiner may change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from usual import Scripted, usual_stages

from toolkit.geometry import rotation_z
from toolkit.perception.explanation import Explanation, Placement
from toolkit.perception.meter import Meter
from toolkit.perception.pipeline import Pipeline, PipelineSettings
from toolkit.plugin_kit.conformance.scene import current_frames, goal_frame, segments_of
from toolkit.stages import (
    MATCHERS,
    RETRIEVERS,
    SEGMENTERS,
    Descriptor,
    Explainer,
    PnP,
    Refiner,
    Registration,
    Retriever,
)
from toolkit.types import Camera, Failure, PnPSolution, Refined

TURN = rotation_z(0.3)


class Watched(Retriever):
    """Brute force that keeps the rankings it is given."""

    def __init__(self):
        self.rankings = []

    def start(self, ranking, instances, observations):
        self.rankings.append(ranking.tolist())
        return RETRIEVERS.create("brute_force").start(ranking, instances, observations)


class Telling(Refiner):
    """Answers every task with `answer`, and believes that goal object i is instance `partners[i]`."""

    def __init__(self, answer=None, partners=()):
        self.answer, self.partners, self.tasks = answer, partners, []

    def refine(self, task):
        self.tasks.append(task)
        return self.answer

    def verify(self, task):
        masks = [segment.mask for segment in segments_of(goal_frame())]
        (number,) = (n for n, mask in enumerate(masks) if (mask == task.segment.mask).all())
        return float(self.partners[number] == task.instance)


class Alike(Descriptor):
    """Tells nothing apart."""

    crop_size = 16

    def describe(self, crops):
        return np.full((len(crops), 4), 0.5, np.float32)


class Counted(PnP):
    """The identity, with as many inliers as `counts` says, instance after instance, and again."""

    def __init__(self, counts):
        self.counts, self.calls = counts, 0

    def solve(self, problem, seed):
        self.calls += 1
        return PnPSolution(np.eye(4), np.arange(len(problem)) < self.counts[(self.calls - 1) % len(self.counts)])


class Helpless(PnP):
    """Solves nothing."""

    def solve(self, problem, seed):
        return Failure("pnp", "helpless")


class Moved(Registration):
    """Turns every camera's place about the vertical."""

    def register(self, frames):
        return [replace(frame, camera=turned(frame.camera)) for frame in frames]

    def locate(self, goal, frames):
        return replace(goal, camera=turned(goal.camera))


def turned(camera):
    return Camera(camera.K, TURN @ camera.T_world_camera, camera.width, camera.height)


def run(**chosen):
    settings = {key: chosen.pop(key) for key in list(chosen) if key in PipelineSettings.model_fields}
    meter = chosen.pop("meter", Meter())
    chosen.setdefault("matcher", MATCHERS.create("sift", {"crop_size": 128}))
    pipeline = Pipeline(usual_stages(**chosen), PipelineSettings(**settings), meter=meter)
    database = pipeline.build_database(current_frames())
    return database, pipeline.estimate(database, goal_frame())


def test_every_region_is_ranked_once_for_each_goal_object():
    retriever = Watched()
    database, estimates = run(retriever=retriever)
    assert [sorted(ranking) for ranking in retriever.rankings] == [list(range(len(database)))] * len(estimates)
    assert len({tuple(ranking) for ranking in retriever.rankings}) > 1


def ranked_instances(**chosen):
    """Instances that each goal object is looked for among."""
    retriever = Watched()
    database, _ = run(retriever=retriever, **chosen)
    return [set(database.instances[ranking].tolist()) for ranking in retriever.rankings]


def test_with_global_every_instance_is_given_once():
    assert ranked_instances(assignment="global") == [{0}, {1}, {2}]


def test_with_truth_nothing_but_the_truth_counts():
    misled = {"descriptor": Alike(), "refiner": Telling(partners=[1, 2, 0])}
    assert ranked_instances(assignment="truth", **misled) == [{0}, {1}, {2}]


def test_the_refiner_decides_between_instances_that_look_alike():
    chosen = {"descriptor": Alike(), "refiner": Telling(partners=[1, 2, 0])}
    assert ranked_instances(assignment="global", **chosen) == [{1}, {2}, {0}]


def test_the_instance_with_the_most_inliers_wins():
    winners = []
    for counts in ([5, 4, 3], [3, 5, 4], [4, 3, 5]):
        matcher, pnp = Scripted(range(1000)), Counted(counts)
        database, (estimate, *_) = run(
            retriever=RETRIEVERS.create("brute_force"), matcher=matcher, pnp=pnp, min_matches=3
        )
        assert estimate.inliers.sum() == 5
        assert {int(database.instances[row]) for row, _ in estimate.candidates} == {estimate.instance}
        winners.append(estimate.instance)
    assert sorted(winners) == [0, 1, 2]


def test_a_failed_solve_says_what_it_was_given():
    _, estimates = run(pnp=Helpless())
    for estimate in estimates:
        assert estimate.failure == Failure("pnp", "helpless") and estimate.instance is not None
        assert sum(count for _, count in estimate.candidates) == len(estimate.correspondences) > 0


def test_the_refiner_has_the_last_word():
    answer = Refined(TURN, 0.7, TURN[None], "none", np.eye(6))
    refiner = Telling(answer)
    _, estimates = run(refiner=refiner)
    for number, (estimate, task) in enumerate(zip(estimates, refiner.tasks, strict=True)):
        # The refiner works in the table's frame, which is this scene's own to within what is measured.
        np.testing.assert_allclose(estimate.T_goal_current, TURN, atol=1e-5)
        np.testing.assert_allclose(estimate.equivalents, TURN[None], atol=1e-5)
        np.testing.assert_allclose(estimate.covariance, np.eye(6), atol=1e-5)
        assert estimate.confidence == 0.7 and estimate.ambiguity == "none"
        assert task.segment is estimate.segment and task.instance == estimate.instance == number
        assert len(task.others) == len(estimates) - 1 and all(other is not task.segment for other in task.others)
        assert len(task.starts) == 1 and estimate.failure is None
    _, estimates = run(refiner=Telling(Failure("refiner", "no")))
    assert all(e.T_goal_current is None and e.failure == Failure("refiner", "no") for e in estimates)
    _, estimates = run(refiner=Telling(None))
    assert all(e.T_goal_current is not None and e.confidence is None for e in estimates)


def test_the_refiner_may_find_what_matches_do_not():
    refiner = Telling(Refined(TURN, 0.7, TURN[None], "none", np.eye(6)))
    matcher = MATCHERS.create("sift", {"crop_size": 128})
    _, estimates = run(refiner=refiner, matcher=matcher, min_matches=10_000)
    assert [task.starts for task in refiner.tasks] == [()] * len(estimates)
    assert [e.instance for e in estimates] == [task.instance for task in refiner.tasks]
    assert {e.status for e in estimates} == {"estimated"}
    _, estimates = run(min_matches=10_000)
    assert {e.failure.stage for e in estimates} == {"matcher"} and all(e.matcher_calls > 0 for e in estimates)


def test_registered_cameras_are_the_ones_that_count():
    plain, (before, *_) = run()
    moved, (after, *_) = run(registration=Moved())
    shifted = TURN @ plain.frames[0].camera.T_world_camera
    np.testing.assert_allclose(moved.frames[0].camera.T_world_camera, shifted, atol=1e-12)
    np.testing.assert_allclose(after.T_goal_current, TURN @ before.T_goal_current @ np.linalg.inv(TURN), atol=1e-6)


@pytest.mark.parametrize("slot", ["goal_segmenter", "matcher"])
def test_what_a_cache_served_is_marked_on_whom_it_concerns(slot):
    """A segmenter serves all objects; a matcher the second one."""
    meter = Meter()

    class Served:
        """The usual stage, which says at its second call that a cache served it."""

        def __init__(self):
            self.stage = SEGMENTERS.create("oracle") if slot == "goal_segmenter" else MATCHERS.create("sift")
            self.crop_size, self.extract = 128, getattr(self.stage, "extract", None)
            self.matched = 0

        def segment(self, frame, current):
            meter.served("segmenter", 3e6)
            return self.stage.segment(frame, current)

        def match(self, query, references):
            self.matched += 1
            if self.matched == 2:
                meter.served("matcher", 1e6)
            return self.stage.match(query, references)

    _, estimates = run(meter=meter, **{slot: Served()})
    stage, whom = ("segmenter", [True] * 3) if slot == "goal_segmenter" else ("matcher", [False, True, False])
    assert [e.cached for e in estimates] == [e.time_ms[stage] >= 1e6 for e in estimates] == whom


class JoinsOnce(Explainer):
    """Finds that instances 1 and 0 are one object in every other goal, and that nothing was moved."""

    def __init__(self):
        self.models = []

    def explain(self, task):
        self.models.append(task.models)
        joined = ((1, 0),) if len(self.models) % 2 else ()
        segment, *_ = segments_of(task.goal)
        return Explanation((Placement(1, np.eye(4), segment, 1.0),), (), joined=joined)


class Counting(Scripted):
    """Counts the crops that features are taken of."""

    crops = 0

    def extract(self, crops):
        self.crops += len(crops)
        return super().extract(crops)


def test_what_one_goal_joins_comes_apart_for_the_next_and_nothing_is_made_twice():
    explainer, matcher = JoinsOnce(), Counting(good=range(100))
    pipeline = Pipeline(usual_stages(explainer=explainer, matcher=matcher), PipelineSettings())
    scene = pipeline.scene(pipeline.build_database(current_frames()))
    apart = set(scene.database.instances.tolist())
    kept = scene.models.get(2)
    instances, counts = [], []
    for _ in range(4):
        scene.estimate(goal_frame())
        instances.append(set(scene.database.instances.tolist()))
        counts.append(matcher.crops)
        assert scene.models.get(2) is kept
    assert instances == [apart - {0}, apart, apart - {0}, apart]
    assert len({id(models) for models in explainer.models}) == 1
    # The third and fourth goals take features of nothing but their own crop.
    assert counts[2] == counts[1] + 1 and counts[3] == counts[2] + 1
