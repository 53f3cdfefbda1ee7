"""Rearrangements end to end: what is perceived is planned, moved, measured and counted."""

from __future__ import annotations

import json
from collections import Counter
from csv import DictReader
from functools import partial
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml
from pages import draw_no_pages
from usual import USUAL

from toolkit.data.objects import load_object_set
from toolkit.data.tabletop import TabletopConfig, draw_scene
from toolkit.errors import ToolkitError
from toolkit.geometry import invert, make_transform, rotation_z, transform_points
from toolkit.harness.ablate import Ablation
from toolkit.harness.drive import drive
from toolkit.harness.experiment import expand, load_experiment
from toolkit.harness.rearrange import Rearrangement
from toolkit.harness.runs import RunOptions
from toolkit.perception.database import Database
from toolkit.perception.fusion import Models, clouds
from toolkit.perception.regions import lift_segment
from toolkit.pictures.film import Film
from toolkit.rearrangement.episode import EpisodeSettings, begun, rearrange
from toolkit.rearrangement.executors.kinematic import Kinematic
from toolkit.rearrangement.sight import SightSettings, correct, look
from toolkit.results.completion import MoveRow, summarize_completion
from toolkit.results.metrics import pose_error
from toolkit.results.rows import read_rows_as
from toolkit.stages import EXECUTORS, PLANNERS
from toolkit.types import Failure, PoseEstimate, Segment

PIPELINE = USUAL | {"refiner": "render_compare", "assignment": "global"}
CONFIG = TabletopConfig(scenes=1, min_objects=3, max_objects=3, views=3, seed=3, renderer="tiny", supersample=1)


@pytest.fixture
def experiment(tmp_path):
    """A small experiment file: two scenes of two objects."""
    data = {
        "name": "small",
        "dataset": {"scenes": 2, "min_objects": 2, "max_objects": 2, "views": 4, "supersample": 1, "renderer": "tiny"},
        "pipeline": PIPELINE,
        "rearrange": {"rounds": 2},
    }
    path = tmp_path / "small.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def lines(run):
    """The rows without what may differ between two runs: times."""
    rows = [json.loads(line) for line in (run / "rows.jsonl").read_text().splitlines()]
    return [{key: value for key, value in row.items() if key != "time_ms"} for row in rows]


def test_a_run_writes_everything_and_repeats_to_the_bit(experiment, tmp_path, monkeypatch):
    runs = [
        drive(
            Rearrangement(),
            load_experiment(str(experiment)),
            RunOptions(out=tmp_path / str(n), workers=n, use_cache=n > 1),
        )
        for n in (1, 2)
    ]
    for name in ("experiment.resolved.yaml", "meta.json", "rows.jsonl", "summary.csv", "report.html"):
        assert (runs[0] / name).stat().st_size > 0
    assert lines(runs[0]) == lines(runs[1])
    rows = read_rows_as(MoveRow, runs[0] / "rows.jsonl")
    assert [(row.scene_id, row.object) for row in rows] == [(0, 0), (0, 1), (1, 0), (1, 1)]
    assert sum(row.success_sym for row in rows) >= 3
    for row in rows:
        assert (row.reason is None) == row.success_sym
        assert row.right_after[-1] == row.success_sym and 1 <= row.rounds == len(row.right_after) <= 2
        assert row.motion_s > 0 and row.time_ms["perception"] > 0

    # Both scenes are shown with every object named, and again the same.
    page = (runs[0] / "report.html").read_text()
    assert page.count("data:image/jpeg") == 2 and "Scenes of 'small', before and after" in page
    for scene_id in (0, 1):
        caption = (runs[0] / "pictures" / f"{scene_id:06d}.txt").read_text()
        assert caption in page and all(row.object_name in caption for row in rows if row.scene_id == scene_id)
        pictures = [(made / "pictures" / f"{scene_id:06d}.png").read_bytes() for made in runs]
        assert pictures[0] == pictures[1]

    draw_no_pages(monkeypatch)
    # What a killed run leaves is taken up again.
    killed = runs[0]
    (killed / "rows.jsonl").write_text("\n".join((killed / "rows.jsonl").read_text().splitlines()[:3]))
    drive(Rearrangement(), load_experiment(str(experiment)), RunOptions(out=killed, resume=True))
    assert lines(killed) == lines(runs[1])

    # The first round of several is what one step gives.
    one = load_experiment(str(experiment), {"rearrange.rounds": [1]})
    one_step = read_rows_as(MoveRow, drive(Rearrangement(), one, RunOptions(out=tmp_path / "one")) / "rows.jsonl")
    assert [row.success_sym for row in one_step] == [row.right_after[0] for row in rows]
    assert summarize_completion(rows)[0].completion_sym_one_step == summarize_completion(one_step)[0].completion_sym


def test_objects_too_wide_for_the_gripper_are_named_and_the_run_goes_on(experiment, tmp_path):
    narrow = {"rearrange.executor.gripper_width_m": [0.005], "dataset.scenes": [1]}
    run = drive(Rearrangement(), load_experiment(str(experiment), narrow), RunOptions(out=tmp_path / "run"))
    rows = read_rows_as(MoveRow, run / "rows.jsonl")
    assert not any(row.success_sym for row in rows)
    wide = [row for row in rows if row.stage == "executor"]
    assert wide and all("cm wide, the gripper opens 0.5 cm" in row.reason for row in wide)
    # What such an object stands in the way of is not tried.
    assert all("which cannot be moved" in row.reason for row in rows if row not in wide)
    with (run / "tables" / "failures.csv").open() as file:
        reasons = {(line["cell"], line["stage"]): (line["reason"], int(line["objects"])) for line in DictReader(file)}
    assert reasons["small", "executor"] == ("the object is N cm wide, the gripper opens N cm", len(wide))
    assert "the gripper opens N cm" in (run / "report.html").read_text()


@pytest.mark.usefixtures("no_pages")
def test_weights_of_planner_and_executor_are_named(experiment, tmp_path, monkeypatch):
    class Weighty(Kinematic):
        """Moves by a network."""

        name = "weighty"

        def digests(self):
            return {"policy.pt": "a" * 64}

    monkeypatch.setattr(EXECUTORS, "_entries", dict(EXECUTORS._entries))
    EXECUTORS.register(Weighty, "here")
    chosen = {"rearrange.executor": ["weighty"], "dataset.scenes": [1], "rearrange.rounds": [1]}
    run = drive(Rearrangement(), load_experiment(str(experiment), chosen), RunOptions(out=tmp_path / "run"))
    weights = [row.weights for row in read_rows_as(MoveRow, run / "rows.jsonl")]
    weights.append(json.loads((run / "meta.json").read_text())["weights"])
    assert weights == [{"policy.pt": "a" * 64}] * 3


MISTAKES = {
    "captures": ({"dataset": {"path": "somewhere"}}, "cannot be rearranged"),
    "planner": ({"rearrange": {"planner": "optmal"}}, "did you mean 'optimal'?"),
    "setting": ({"rearrange": {"planner": {"name": "paper", "max_trys": 3}}}, "did you mean 'max_tries'?"),
    "grasp": ({"rearrange": {"executor": {"name": "arm", "grasp": "antipodl"}}}, "did you mean 'antipodal'?"),
    "grasp setting": (
        {"rearrange": {"executor": {"name": "arm", "grasp": {"name": "antipodal", "fricton": 1}}}},
        "grasp 'antipodal': unknown setting 'fricton'; did you mean 'friction'?",
    ),
    "rounds": ({"rearrange": {"rounds": 0}}, "rounds"),
    "recording": ({"rearrange": {"executor": {"name": "replay", "folder": "nowhere"}}}, "is no recording"),
    "objects": ({"dataset": {"objects": "nowhere"}}, "is not a folder"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_mistakes_are_named_before_any_work(case, experiment, tmp_path):
    change, said = MISTAKES[case]
    experiment.write_text(yaml.safe_dump({**yaml.safe_load(experiment.read_text()), **change}))
    with pytest.raises(ToolkitError, match=said):
        drive(Rearrangement(), load_experiment(str(experiment)), RunOptions(out=tmp_path / "run"))
    assert not (tmp_path / "run").exists()


def test_ablate_sends_rearrangements_on(experiment, tmp_path):
    with pytest.raises(ToolkitError, match="run it with `toolkit rearrange`"):
        drive(Ablation(), load_experiment(str(experiment)), RunOptions(out=tmp_path / "run"))


def test_any_experiment_can_be_rearranged_and_stages_sweep():
    loaded = load_experiment("quick", {"rearrange.planner": ["optimal", "paper"]}, rearranges=True)
    cells = expand(loaded)
    assert [cell.rearrange.planner.name for cell in cells] == ["optimal", "paper"]
    assert [cell.name for cell in cells] == ["planner=optimal", "planner=paper"]
    assert cells[1].resolved()["rearrange"]["planner"] == {
        "name": "paper",
        "max_failures": 2,
        "max_tries": 20,
        "samples": 200,
    }
    table = {cell.name for cell in expand(load_experiment("paper_table2"))}
    assert table == {
        f"{rounds}, {views}" for rounds in ("multi-step", "one step") for views in ("multi-view", "single-view")
    }


# One episode, with perception under control


EXACT = (np.eye(4),)


class KnownPipeline:
    """Perception that knows the truth, and is off by what `errors` says of every look."""

    def __init__(self, scene, executor, errors=EXACT):
        self.known, self.executor, self.errors, self.looks = scene, executor, errors, 0

    def build_database(self, frames):
        regions, instances = [], []
        for frame in frames:
            for number, mask in frame.true_masks.items():
                regions.append(lift_segment(frame, Segment(mask)))
                instances.append(number)
        return Database(tuple(frames), tuple(regions), np.array(instances), np.zeros((len(regions), 1)))

    def scene(self, database):
        seen = partial(clouds, database, Models(database))
        return SimpleNamespace(database=database, estimate=partial(self.estimate, database), clouds=seen)

    def estimate(self, database, goal):
        error = self.errors[min(self.looks, len(self.errors) - 1)]
        self.looks += 1
        estimates = []
        for position, number in enumerate(goal.true_masks):
            T = error @ self.known.goal[number] @ invert(self.executor.state()[number])
            estimates.append(PoseEstimate(position, Segment(goal.true_masks[number]), number, T, confidence=0.9))
        return estimates


@pytest.fixture(scope="module")
def scene(cache):
    return draw_scene(CONFIG, load_object_set("procedural", cache), 0, cache)


@pytest.fixture
def executor():
    kinematic = Kinematic()
    yield kinematic
    kinematic.close()


def run(scene, executor, planner="optimal", errors=EXACT, **settings):
    pipeline = KnownPipeline(scene, executor, errors)
    goal = executor.begin(scene)
    return rearrange(goal, pipeline, PLANNERS.create(planner), executor, EpisodeSettings(**settings), seed=0)


def right(scene, state):
    return [
        pose_error(state[number] @ invert(truth.T_world_current), truth).success
        for number, truth in scene.truth.items()
    ]


@pytest.mark.parametrize("planner", PLANNERS.names())
@pytest.mark.parametrize("observe", ["round", "move"])
def test_perfect_perception_sets_every_object_right(scene, executor, planner, observe):
    episode = run(scene, executor, planner, observe=observe)
    assert all(right(scene, executor.state()))
    assert not episode.failures and episode.rounds == 1
    if planner == "optimal":
        assert episode.moves.total() == 3 + episode.forced_buffers
    assert set(episode.moved_for.values()) == {0, 1, 2}


def test_a_second_look_corrects_what_the_first_got_wrong(scene, executor):
    off = make_transform(rotation_z(np.radians(8))[:3, :3], np.array([0.005, 0, 0]))
    episode = run(scene, executor, errors=(off, np.eye(4)))
    assert not any(right(scene, episode.states[0]))
    assert all(right(scene, executor.state())) and episode.rounds == 2
    run(scene, executor, errors=(off, np.eye(4)), rounds=1)
    assert not any(right(scene, executor.state()))


def test_small_motions_are_not_worth_a_move(scene, executor):
    """The second look is off by less than what counts as settled."""
    nearly = make_transform(rotation_z(np.radians(1))[:3, :3], np.array([0.002, 0, 0]))
    episode = run(scene, executor, errors=(np.eye(4), nearly))
    assert episode.rounds == 1


def test_perception_that_breaks_is_a_named_failure(scene, executor):
    class Broken(KnownPipeline):
        def estimate(self, database, goal):
            raise ZeroDivisionError("oops")

    pipeline, goal = Broken(scene, executor), executor.begin(scene)
    episode = rearrange(goal, pipeline, PLANNERS.create("optimal"), executor, EpisodeSettings(), seed=0)
    assert episode.broken == Failure("pipeline", "ZeroDivisionError: oops")
    assert episode.moves == Counter()


def test_nothing_hides_why_a_task_cannot_be_taken_up(scene):
    class Clumsy(Kinematic):
        def begin(self, task):
            raise ToolkitError("the robot does not answer")

        def close(self):
            raise AttributeError("_arm")

    with pytest.raises(ToolkitError, match="the robot does not answer"), begun(Clumsy(), scene):
        pass


def test_a_film_shows_the_goal_beside_what_happens(scene, executor, tmp_path):
    with Film(executor, tmp_path / "film.mp4", every=10):
        run(scene, executor)
    video = cv2.VideoCapture(str(tmp_path / "film.mp4"))
    pictures = []
    while (read := video.read())[0]:
        pictures.append(read[1])
    first, last = pictures[0].astype(float), pictures[-1].astype(float)
    assert first.shape == (480, 1280, 3) and len(pictures) > 60

    def differ(picture):
        """Mean difference of the left half, the goal, and the right half, below the captions."""
        return np.abs(picture[60:, :640] - picture[60:, 640:]).mean()

    assert differ(last) < 0.5 * differ(first)
    assert executor.on_step is None


def test_a_film_that_cannot_be_written_is_one_sentence(scene, executor, tmp_path):
    with pytest.raises(ToolkitError, match="cannot be written"), Film(executor, tmp_path / "nowhere" / "film.mp4"):
        run(scene, executor)


# Sights


def seen(scene, executor, change=lambda estimates: estimates):
    goal = executor.begin(scene)

    class Changed(KnownPipeline):
        def estimate(self, database, goal):
            return change(super().estimate(database, goal))

    return look(Changed(scene, executor), executor.observe(), goal, SightSettings()), goal


def changed(estimate, **values):
    fields = {name: getattr(estimate, name) for name in estimate.__dataclass_fields__}
    return PoseEstimate(**{**fields, **values})


def test_an_instance_goes_to_the_goal_object_that_is_surest(scene, executor):
    def claim(estimates):
        return [estimates[0], changed(estimates[1], instance=0, confidence=0.99), estimates[2]]

    sight, _ = seen(scene, executor, claim)
    assert sight.goal_objects == {0: 1, 2: 2}
    assert "goal object 1 is taken for the same object" in sight.failures[0].reason
    assert sight.layout.item(1).goal is None and sight.layout.item(0).goal is not None


def test_what_a_move_changes_is_another_sight(scene, executor):
    sight, _ = seen(scene, executor)
    was = {number: cloud.copy() for number, cloud in sight.clouds.items()}
    move = sight.layout.items[0].to_goal()
    then = sight.after(move)
    np.testing.assert_allclose(then.clouds[0], transform_points(move.T_place_pick, was[0]))
    assert then.layout.item(0).settled and not sight.layout.item(0).settled
    for number, cloud in was.items():
        np.testing.assert_array_equal(sight.clouds[number], cloud)
        assert number == 0 or then.clouds[number] is sight.clouds[number]


def test_what_looks_settled_in_one_of_its_equivalents_is(scene, executor):
    def symmetric(estimates):
        either = np.stack([estimates[0].T_goal_current, np.eye(4)])
        return [changed(estimates[0], equivalents=either, ambiguity="symmetric"), *estimates[1:]]

    sight, _ = seen(scene, executor, symmetric)
    assert [item.settled for item in sight.layout.items] == [True, False, False]


def test_failed_estimates_keep_their_reason(scene, executor):
    failure = Failure("matcher", "no match")
    sight, _ = seen(scene, executor, lambda e: [changed(e[0], T_goal_current=None, failure=failure), *e[1:]])
    assert sight.failures == {0: failure} and not sight.layout.item(0).wanted


def test_objects_keep_their_names_from_look_to_look(scene, executor):
    class Renamed(KnownPipeline):
        def build_database(self, frames):
            database = super().build_database(frames)
            return Database(database.frames, database.regions, (database.instances + 1) % 3, database.descriptors)

        def estimate(self, database, goal):
            return [changed(e, instance=(e.instance + 1) % 3) for e in super().estimate(database, goal)]

    goal = executor.begin(scene)
    frames = executor.observe()
    first = look(KnownPipeline(scene, executor), frames, goal, SightSettings())
    second = look(Renamed(scene, executor), frames, goal, SightSettings())
    assert not np.allclose(first.layout.item(0).footprint.center, second.layout.item(0).footprint.center)
    merged = correct(first, second)
    for item, before in zip(merged.layout.items, first.layout.items, strict=True):
        assert item.object == before.object
        np.testing.assert_allclose(item.footprint.support, before.footprint.support)
        np.testing.assert_allclose(item.T_goal_current, before.T_goal_current)
        np.testing.assert_array_equal(merged.clouds[item.object], first.clouds[item.object])
