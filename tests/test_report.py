"""The report: self-contained, truthful about what can be compared, and safe with any text."""

from __future__ import annotations

import io
import re

import numpy as np
import pytest
from rich.console import Console

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, project
from toolkit.pictures import overlay
from toolkit.report import write_report
from toolkit.report.page import _compare
from toolkit.results import Row, print_table, read_rows, summarize, write_rows


def make_rows(cell, share, dataset="a", scenes=20, **fields):
    """Rows of which a share is right, the same objects in every cell."""
    rng = np.random.default_rng(0)
    rank = rng.permutation(scenes * 3)
    return [
        Row(
            cell=cell,
            settings={"pipeline.views": cell},
            dataset=dataset,
            scene_id=i // 3,
            scene=f"{i // 3:06d}",
            object=i % 3,
            object_name=f"object_{i % 7}",
            symmetry="none",
            **_outcome(bool(rank[i] < share * scenes * 3)),
            **fields,
        )
        for i in range(scenes * 3)
    ]


def _outcome(right):
    if not right:
        return {"status": "failed", "stage": "pnp", "reason": "5 inliers of 12, at least 8 are needed <b>&"}
    errors = {"rotation_error_deg": 1.0, "translation_error_cm": 0.5}
    symmetric = {f"{key}_sym": value for key, value in errors.items()}
    return {"status": "estimated", "success": True, "success_sym": True, **errors, **symmetric}


def test_the_report_needs_nothing_else(tmp_path):
    write_rows(tmp_path / "rows.jsonl", make_rows("good", 0.9) + make_rows("<script>bad", 0.4))
    page = write_report(tmp_path).read_text()
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!data:|#)", page)
    assert "<script>" not in page
    assert "good puts 90% of 60 objects" in page
    assert "N inliers of N, at least N are needed &lt;b&gt;&amp;" in page


def test_a_run_without_rows_is_said_to_be_so(tmp_path):
    write_rows(tmp_path / "rows.jsonl", [])
    with pytest.raises(ToolkitError, match="no rows"):
        write_report(tmp_path)


def test_cells_are_compared_on_the_same_scenes_only():
    rows = make_rows("a1", 0.9) + make_rows("a2", 0.5) + make_rows("b1", 0.3, dataset="b")
    (comparison,) = _compare(rows)
    assert (comparison.cell, comparison.best) == ("a2", "a1")
    assert comparison.difference == pytest.approx(-0.4)
    assert comparison.p < 1e-5 and "worse" in comparison.verdict


def test_rows_survive_their_file(tmp_path):
    rows = make_rows("a", 0.5)
    write_rows(tmp_path / "rows.jsonl", rows)
    assert read_rows(tmp_path / "rows.jsonl") == rows
    with (tmp_path / "rows.jsonl").open("a") as file:
        file.write('{"cell": "a", "torn')
    assert read_rows(tmp_path / "rows.jsonl") == rows


@pytest.mark.parametrize("width", [80, 140])
def test_the_table_fits_its_console(width):
    console = Console(width=width, record=True, file=io.StringIO())
    print_table(summarize(make_rows("rotation_deg=180,views=all", 0.9)), console)
    text = console.export_text()
    assert "rotation_deg=180,views=all" in text
    assert "1.00 [1.00, 1.00]" in text and "90% [80, 95]" in text
    assert ("matcher calls" in text) == (width > 110)


def test_an_outline_lies_around_the_object(capture):
    truth = next(iter(capture.truth.values()))
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    grid = np.random.default_rng(0).random((4000, 3))
    box = truth.model.box_min + np.concatenate([corners, grid]) * truth.model.box_size
    world = box @ truth.T_world_goal[:3, :3].T + truth.T_world_goal[:3, 3]
    picture = overlay(capture.goal, [("0", world, (255, 0, 0))])
    changed = np.argwhere((picture != capture.goal.rgb).any(axis=2))[:, ::-1]
    pixels, _ = project(capture.goal.camera.K, invert(capture.goal.camera.T_world_camera), world)
    drawn = changed[(picture[changed[:, 1], changed[:, 0]] == [255, 0, 0]).all(axis=1)]
    assert len(drawn) > 50
    # The label, in the outline's colour, stands above the box.
    low, high = pixels.min(axis=0) - [6, 30], pixels.max(axis=0) + 6
    assert ((drawn >= low) & (drawn <= high)).all()


def test_confidence_is_shown_where_it_is_stated(tmp_path):
    rows = [row.model_copy(update={"confidence": 0.9 if row.success else 0.2}) for row in make_rows("sure", 0.8)]
    write_rows(tmp_path / "rows.jsonl", rows + make_rows("silent", 0.5))
    assert "stated confidence" in write_report(tmp_path).read_text()
    write_rows(tmp_path / "rows.jsonl", make_rows("silent", 0.5))
    assert "stated confidence" not in write_report(tmp_path).read_text()
