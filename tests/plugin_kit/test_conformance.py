"""The conformance kit finds what is broken, says it in a sentence, and lets nothing a plugin raises get out."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pydantic import Field

from toolkit.errors import ToolkitError
from toolkit.perception.indexes.numpy import NumpyIndex
from toolkit.perception.retrieval.brute_force import BruteForce
from toolkit.perception.retrieval.instance_vote import InstanceVote
from toolkit.plugin_kit.conformance import check_plugin, checks_of, general, kit
from toolkit.rearrangement.grasps.antipodal import Antipodal
from toolkit.rearrangement.planners.optimal import Optimal
from toolkit.registry import Plugin, PluginConfig
from toolkit.sim.robots import ROBOTS
from toolkit.stages import REGISTRIES
from toolkit.types import Failure
from toolkit.weights.cards import WeightCard

ROOT = Path(__file__).parents[2]


def notes(plugin, **settings):
    """What is wrong with a plugin, by check."""
    return {outcome.check: outcome.note for outcome in check_plugin(plugin, settings) if not outcome.passed}


def test_every_stage_has_checks_of_its_own():
    for stage in REGISTRIES:
        own = [check for check in checks_of(stage) if check not in general.CHECKS]
        assert checks_of(stage) == [*general.CHECKS, *own]
        assert len(own) >= 2 and {check.__module__ for check in own} == {kit.STAGE_CHECKS[stage]}
    with pytest.raises(ToolkitError, match="unknown stage 'matchr'"):
        checks_of("matchr")


def test_a_sound_plugin_passes_every_check():
    outcomes = check_plugin(NumpyIndex)
    assert [outcome.check for outcome in outcomes] == [kit.title(check) for check in checks_of("index")]
    assert all(outcome.passed for outcome in outcomes)


def test_an_outcome_has_the_time_and_memory_of_its_check(monkeypatch):
    clock, peaks = iter([10.0, 12.5]), iter([100.0, 160.0])
    monkeypatch.setattr(kit, "time", SimpleNamespace(perf_counter=lambda: next(clock)))
    monkeypatch.setattr(kit, "_peak_mb", lambda: next(peaks))
    outcome = kit.run_check(lambda subject: "a remark", kit.Subject(NumpyIndex))
    assert outcome == kit.Outcome("<lambda>", True, "a remark", 2.5, 60.0)


class Broken(NumpyIndex):
    """An index whose methods a test replaces."""

    name = "broken"


def test_what_raises_is_reported_with_its_place():
    class Raises(Broken):
        """Divides by zero."""

        def search(self, queries, k):
            return 1 / 0

    found = notes(Raises)
    assert len(found) == 5
    assert all("raises ZeroDivisionError: division by zero" in note and "line" in note for note in found.values())


def test_wrong_types_and_shapes_are_named():
    class Doubles(Broken):
        """Answers in float64."""

        def search(self, queries, k):
            scores, rows = super().search(queries, k)
            return scores.astype(np.float64), rows

    class Short(Broken):
        """Answers with one row too few."""

        def search(self, queries, k):
            return tuple(part[:, : k - 1] for part in super().search(queries, k))

    assert "must be float32, got float64" in notes(Doubles)["scores fall and belong to their rows"]
    assert "must have shape 7x10, got 7x9" in notes(Short)["scores fall and belong to their rows"]


def test_global_randomness_is_found():
    class Random(InstanceVote):
        """Shuffles by the global generator."""

        def start(self, ranking, instances, observations):
            return super().start(np.random.permutation(ranking), instances, observations)

    assert set(notes(Random)) >= {"the same input gives the same bytes"}


def test_state_that_leaks_between_objects_is_found():
    class Leaky(BruteForce):
        """Uses one traversal for all objects."""

        def start(self, ranking, instances, observations):
            if not hasattr(self, "_only"):
                self._only = super().start(ranking, instances, observations)
            return self._only

    assert "objects do not disturb each other" in notes(Leaky)


def test_settings_that_are_not_described_or_lost_in_a_file_are_found():
    class Config(PluginConfig):
        plain: int = 3
        lost: float = Field(2.0, description="Not in the file.", exclude=True)

    class Careless(Broken):
        """Settings without care."""

    Careless.Config = Config
    assert "setting 'plain' has no description" in notes(Careless)["settings are frozen and described"]
    assert "change when they are written" in notes(Careless, lost=5.0)["settings survive a file"]


def test_weights_need_a_card_with_their_licence():
    class Weighty(Broken):
        """Has weights."""

        def digests(self):
            return {"mine.pt": "a" * 64}

    assert "no weight card states the licence of 'mine.pt'" in notes(Weighty)["weights have a digest and a licence"]

    class Carded(Weighty):
        """Has weights and their card."""

        cards = (WeightCard("mine", "mine.pt", "a net", "MIT", 1.0, (), "me", non_commercial=True),)

    (outcome,) = (o for o in check_plugin(Carded) if o.check == "weights have a digest and a licence")
    assert outcome.passed and outcome.note == "mine: MIT, non-commercial"


def test_what_it_lacks_is_said_before_any_check():
    class Lacking(Broken):
        """Lacks a file."""

        def check_ready(self):
            raise ToolkitError("put mine there")

    with pytest.raises(ToolkitError, match="put mine there"):
        check_plugin(Lacking)


def test_a_constructor_that_raises_is_reported():
    class Unborn(Broken):
        """Cannot be made."""

        def __init__(self, config=None):
            raise RuntimeError("no")

    assert "raises RuntimeError: no" in notes(Unborn)["settings survive a file"]


def test_a_planner_that_runs_into_things_is_found():
    class Blind(Optimal):
        """Sends every object to its goal at once."""

        def start(self, seed):
            return self

        def next(self, layout):
            from toolkit.rearrangement.moves import Finished

            wanted = [item for item in layout.items if item.wanted]
            return wanted[0].to_goal() if wanted else Finished()

    assert "puts object 0 onto object [1]" in notes(Blind)["a swap is solved without a collision"]


def test_an_empty_answer_where_a_failure_is_due_is_found():
    class Silent(Plugin):
        """Says nothing."""

        stage, name = "grasp", "silent"

        def grasp(self, request, seed):
            return [] if len(request.points) < 10 else Failure("grasp", "no")

    found = notes(Silent)
    assert "an empty list must be a Failure" in found["no grasp is a failure"]
    assert "no grasp of an easy box" in found["grasps hold a box"]


def test_a_grasper_that_knows_one_gripper_only_is_found():
    class Stubborn(Antipodal):
        """Grasps for the gripper at hand, whatever is asked."""

        def grasp(self, request, seed):
            return super().grasp(replace(request, gripper=ROBOTS["gen3"].gripper), seed)

    assert set(notes(Stubborn)) == {"what the gripper does not span is a failure"}


def run(*command, folder):
    path = os.pathsep.join(p for p in (str(ROOT), os.environ.get("PYTHONPATH")) if p)
    return subprocess.run(
        [sys.executable, *map(str, command)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path, "NO_COLOR": "1", "COLUMNS": "160"},
        capture_output=True,
        text=True,
        check=False,
    )


def toolkit(*arguments, folder):
    return run("-c", "from toolkit.cli.commands import main; main()", *arguments, folder=folder)


def test_the_command_prints_a_table_and_exits_non_zero_where_a_check_fails(tmp_path):
    done = toolkit("check", "index", "numpy", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "passes all 10 checks" in done.stdout
    broken = tmp_path / "broken.py"
    broken.write_text(
        'from toolkit.registry import Plugin\nclass Bad(Plugin):\n    """Bad."""\n    stage, name = "index", "bad"\n'
        "    def build(self, vectors):\n        raise KeyError('lost')\n"
    )
    done = toolkit("check", "index", "bad", "--plugin", broken, folder=tmp_path)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr and done.stderr.startswith("error: index 'bad' fails 5 of 10 checks; ")
    assert "raises KeyError" in done.stdout and "failed" in done.stdout
    done = toolkit("check", "index", "nunpy", folder=tmp_path)
    assert done.returncode == 2 and "did you mean 'numpy'?" in done.stderr
    done = toolkit("check", "matcher", "sift", "--set", "ratoi=2", folder=tmp_path)
    assert done.returncode == 2 and "did you mean 'ratio'?" in done.stderr


def test_a_plugins_own_tests_are_two_lines(tmp_path):
    (tmp_path / "test_mine.py").write_text(
        "from toolkit.plugin_kit.conformance import Conforms\n"
        "from toolkit.perception.indexes.numpy import NumpyIndex\n"
        "class TestMine(Conforms): plugin = NumpyIndex\n"
    )
    done = run(
        "-m", "pytest", "-q", "-p", "toolkit.plugin_kit.pytest_plugin", "-p", "no:cacheprovider", folder=tmp_path
    )
    assert "10 passed" in done.stdout, done.stdout
