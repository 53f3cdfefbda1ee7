from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from usual import usual_stages

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, project
from toolkit.perception.database import Database
from toolkit.perception.meter import Meter
from toolkit.perception.pipeline import Pipeline, PipelineSettings
from toolkit.results.scoring import score
from toolkit.slots import SLOTS
from toolkit.stages import MATCHERS, RETRIEVERS
from toolkit.types import Correspondences, Failure, Frame, Matches, PnPSolution, PoseEstimate, Segment


def motions(estimates):
    return [None if e.T_goal_current is None else e.T_goal_current.tobytes() for e in estimates]


def test_the_pipeline_finds_the_motions(capture):
    rows = score(capture, Pipeline(usual_stages()).run(capture))
    assert len(rows) == len(capture.truth)
    assert sum(row.success_sym for row in rows) >= 2


def test_the_same_seed_gives_the_same_bytes(capture):
    first, again = (motions(Pipeline(usual_stages(), seed=4).run(capture)) for _ in range(2))
    assert first == again


def test_truth_fed_as_estimate_scores_perfectly(capture):
    estimates = [
        PoseEstimate(i, Segment(capture.goal.true_masks[k]), k, truth.T_goal_current)
        for i, (k, truth) in enumerate(capture.truth.items())
    ]
    for row in score(capture, estimates):
        assert (row.rotation_error_deg, row.translation_error_cm, row.success) == (0.0, 0.0, True)
        assert (row.rotation_error_deg_sym, row.translation_error_cm_sym, row.success_sym) == (0.0, 0.0, True)


def test_every_true_object_has_a_row_even_with_no_estimate(capture):
    rows = score(capture, [])
    assert [row.status for row in rows] == ["missed"] * len(capture.truth)
    assert not any(row.success for row in rows)


@pytest.mark.parametrize("fuse", ["all", "first"])
@pytest.mark.parametrize("retriever", ["instance_vote", "brute_force"])
def test_matcher_calls_are_counted(capture, fuse, retriever):
    chosen = usual_stages(retriever=RETRIEVERS.create(retriever))
    pipeline = Pipeline(chosen, PipelineSettings(fuse=fuse))
    database = pipeline.build_database(capture.current)
    for estimate in pipeline.estimate(database, capture.goal):
        assert 1 <= estimate.matcher_calls <= len(database)
        if fuse == "all" and retriever == "brute_force":
            assert estimate.matcher_calls == len(database)


def test_inliers_reproject_onto_the_goal(capture):
    stages = usual_stages()
    estimates = [e for e in Pipeline(stages).run(capture) if e.T_goal_current is not None]
    assert len(estimates) >= 2
    for estimate in estimates:
        camera = capture.goal.camera
        problem = estimate.correspondences
        pixels, _ = project(camera.K, invert(camera.T_world_camera), estimate.move(problem.points))
        error = np.linalg.norm(pixels - problem.pixels, axis=1)
        np.testing.assert_array_equal(error < stages.pnp.config.reprojection_px, estimate.inliers)
        assert sum(count for _, count in estimate.candidates) == len(problem)


class Recording(Meter):
    """A meter that keeps what was taken from it."""

    def __init__(self):
        super().__init__()
        self.total = Counter()

    def take(self):
        times, cached = super().take()
        self.total.update(times)
        return times, cached


def test_the_estimates_share_all_the_time_there_was_by_stage(capture):
    meter = Recording()
    estimates = Pipeline(usual_stages(), meter=meter).run(capture)
    assert set(meter.total) == {*SLOTS.values()}
    for stage, total in meter.total.items():
        assert total > 0 and sum(e.time_ms.get(stage, 0.0) for e in estimates) == pytest.approx(total)
    for stage in ("segmenter", "associator", "descriptor", "index"):
        assert len({e.time_ms[stage] for e in estimates}) == 1


def test_views_are_spread_evenly_and_too_many_is_an_error(capture):
    two = Pipeline(usual_stages(), PipelineSettings(views=2)).build_database(capture.current)
    assert [frame.index for frame in two.frames] == [0, 2]
    with pytest.raises(ToolkitError, match="views is 9, but the capture has 4"):
        Pipeline(usual_stages(), PipelineSettings(views=9)).build_database(capture.current)


class Counting:
    """Sift that counts the crops it is given."""

    def __init__(self):
        self.sift, self.extracted = MATCHERS.create("sift"), 0
        self.crop_size, self.match = self.sift.crop_size, self.sift.match

    def extract(self, crops):
        self.extracted += len(crops)
        return self.sift.extract(crops)


def test_a_scene_keeps_what_it_made_for_further_goals_and_a_pipeline_keeps_nothing(capture):
    matcher = Counting()
    pipeline = Pipeline(usual_stages(matcher=matcher))
    database = pipeline.build_database(capture.current)
    scene = pipeline.scene(database)
    once = motions(scene.estimate(capture.goal))
    regions, objects = matcher.extracted - len(once), len(once)
    assert regions > objects
    assert motions(scene.estimate(capture.goal)) == once == motions(pipeline.estimate(database, capture.goal))
    assert matcher.extracted == (regions + objects) + objects + (regions + objects)


class Blind:
    """Matches nothing."""

    crop_size = 64

    def extract(self, crops):
        return list(crops)

    def match(self, query, references):
        return [Matches.empty() for _ in references]


class Nothing:
    """Segments nothing."""

    def segment(self, frame, current):
        return []


class Helpless:
    """Solves nothing."""

    def solve(self, problem: Correspondences, seed: int) -> PnPSolution | Failure:
        return Failure("pnp", "helpless")


def test_failures_are_values_with_stage_and_reason(capture):
    cases = {
        "matcher": usual_stages(matcher=Blind()),
        "pnp": usual_stages(pnp=Helpless()),
        "segmenter": usual_stages(segmenter=Nothing()),
    }
    for stage, chosen in cases.items():
        estimates = Pipeline(chosen).run(capture)
        assert len(estimates) == 3
        assert {e.failure.stage for e in estimates} == {stage}
        rows = score(capture, estimates)
        assert {row.stage for row in rows} == {stage} and not any(row.success for row in rows)


def test_a_goal_without_objects_gives_no_estimate(capture):
    assert Pipeline(usual_stages(goal_segmenter=Nothing())).run(capture) == []


def test_one_object_only(capture):
    def keep(frame: Frame) -> Frame:
        return replace(frame, true_masks={k: m for k, m in frame.true_masks.items() if k == 0})

    single = replace(capture, current=tuple(map(keep, capture.current)), goal=keep(capture.goal))
    assert len(Pipeline(usual_stages()).run(single)) == 1


def test_a_region_with_no_depth_is_dropped_and_counted(capture):
    frame = capture.current[0]
    depth = frame.depth.copy()
    depth[frame.true_masks[0]] = 0
    holed = replace(frame, depth=depth)
    database = Pipeline(usual_stages()).build_database([holed, *capture.current[1:]])
    whole = Pipeline(usual_stages()).build_database(capture.current)
    assert database.dropped == whole.dropped + 1 and len(database) == len(whole) - 1


def test_a_database_survives_a_round_trip(capture, tmp_path):
    pipeline = Pipeline(usual_stages())
    database = pipeline.build_database(capture.current)
    database.save(tmp_path / "h.npz")
    loaded = Database.load(tmp_path / "h.npz")
    assert motions(pipeline.estimate(loaded, capture.goal)) == motions(pipeline.estimate(database, capture.goal))
    (tmp_path / "h.npz").write_bytes(b"nonsense")
    with pytest.raises(ToolkitError, match="cannot be read"):
        Database.load(tmp_path / "h.npz")
