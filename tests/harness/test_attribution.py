"""Attribution: one truth at a time, and what is left with all of them."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from made_rows import make_rows
from rich.console import Console

from toolkit.errors import ToolkitError
from toolkit.harness.ablate import Ablation
from toolkit.harness.attribution import attribution
from toolkit.harness.experiment import expand, load_experiment
from toolkit.perception.assignment import true_instances
from toolkit.perception.database import Database
from toolkit.plugin_kit.conformance.scene import current_frames, goal_frame, regions, segments_of
from toolkit.results.comparisons import ALL_TRUE, AS_IT_IS, compare_cells
from toolkit.results.report import write_report
from toolkit.results.rows import write_rows
from toolkit.results.stats import holm, mcnemar
from toolkit.types import Segment


def test_one_truth_is_put_in_at_a_time():
    cells = {cell.name: cell.pipeline for cell in expand(attribution(load_experiment("estimate")))}
    plain = cells[AS_IT_IS]
    assert list(cells) == [
        AS_IT_IS,
        "true masks in the frames",
        "true masks in the goal",
        "true association",
        "true retrieval",
        ALL_TRUE,
    ]
    assert cells["true masks in the goal"] == plain.model_copy(
        update={"goal_segmenter": cells[ALL_TRUE].goal_segmenter, "explainer": cells[ALL_TRUE].explainer}
    )
    assert (plain.explainer.name, cells[ALL_TRUE].explainer.name) == ("perch", "none")
    assert cells["true retrieval"].assignment == "truth" and plain.assignment == "global"
    assert {cells[ALL_TRUE].segmenter.name, cells[ALL_TRUE].associator.name} == {"oracle"}


def test_stages_that_have_the_truth_are_left_out():
    names = [cell.name for cell in attribution(load_experiment("render_compare")).cells]
    assert "true masks in the goal" not in names and "true retrieval" in names


def test_a_sweep_is_refused():
    with pytest.raises(ToolkitError, match="takes one setting"):
        attribution(load_experiment("quick"))
    with pytest.raises(ToolkitError, match="takes one setting"):
        attribution(load_experiment("beyond_paper"))


def test_costs_are_measured_from_the_setting_as_it_is(tmp_path):
    rows = make_rows(AS_IT_IS, 0.6) + make_rows("true retrieval", 0.8) + make_rows(ALL_TRUE, 0.95)
    found = compare_cells(rows)
    assert [(c.cell, c.against) for c in found] == [("true retrieval", AS_IT_IS), (ALL_TRUE, AS_IT_IS)]
    assert found[0].success.mean == pytest.approx(0.2)
    success = [[r.success_sym for r in rows if r.cell == c] for c in (AS_IT_IS, "true retrieval", ALL_TRUE)]
    assert [c.p for c in found] == holm([mcnemar(success[0], success[1]), mcnemar(success[0], success[2])])
    console = Console(width=140, record=True, file=io.StringIO())
    write_rows(tmp_path / "rows.jsonl", rows)
    Ablation().print(tmp_path, console)
    text = console.export_text()
    assert "What each stage costs" in text and "lost in matching, PnP and refinement" in text
    assert "lost in matching, PnP and refinement" in write_report(tmp_path).read_text()


def database(instances, order):
    found, _ = regions()
    return Database(current_frames(), tuple(found[i] for i in order), instances, np.zeros((len(order), 1), np.float32))


def test_true_instances_are_those_of_the_masks_whatever_they_are_called():
    _, boxes = regions()
    order = np.random.default_rng(0).permutation(len(boxes))
    renamed = np.array([2, 0, 1])[boxes[order]]
    segments = segments_of(goal_frame())
    assert true_instances(database(renamed, order), goal_frame(), segments).tolist() == [2, 0, 1]


def test_what_shows_no_known_object_has_no_instance():
    _, boxes = regions()
    order = np.flatnonzero(boxes != 1)
    table = np.zeros(goal_frame().rgb.shape[:2], bool)
    table[:5, :5] = True
    segments = [*segments_of(goal_frame()), Segment(table)]
    instances = np.unique(boxes[order], return_inverse=True)[1]
    assert true_instances(database(instances, order), goal_frame(), segments).tolist() == [0, -1, 1, -1]
    with pytest.raises(ToolkitError, match="needs true masks"):
        true_instances(database(instances, order), replace(goal_frame(), true_masks=None), segments)
