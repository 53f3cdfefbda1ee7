"""The report: self-contained, truthful about what can be compared, and safe with any text."""

from __future__ import annotations

import csv
import io
import json
import re
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
import yaml
from made_rows import make_move_rows, make_rows
from markupsafe import escape
from matplotlib.figure import Figure as Drawing
from rich.console import Console

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, project
from toolkit.pictures.cases import write_case
from toolkit.pictures.drawing import overlay
from toolkit.results.comparisons import compare_cells, comparison_table, shown_in_words
from toolkit.results.completion import telling_scenes
from toolkit.results.figure_table import Column, Figure, FigureTable, Line
from toolkit.results.report import write_completion_report, write_report
from toolkit.results.report.plots import error_curves
from toolkit.results.rows import read_rows, summarize, summary_lines, write_rows, write_summary
from toolkit.results.stats import holm, mcnemar, newcombe_interval
from toolkit.results.tables import motion_table

PAGES = {"motion": (make_rows, write_report), "completion": (make_move_rows, write_completion_report)}


@pytest.fixture(params=PAGES)
def write(request, tmp_path):
    """Writes the page of a run with rows of two cells, the second of a name that must be escaped."""
    make, write_page = PAGES[request.param]

    def write(good=0.9, bad=0.4):
        write_rows(tmp_path / "rows.jsonl", make("good", good) + make("<script>bad", bad))
        return write_page(tmp_path).read_text()

    return write


def test_the_report_needs_nothing_else(write):
    page = write()
    assert not re.search(r"(src|href)\s*=\s*[\"'](?!data:|#)", page)
    assert "<script>" not in page and "&lt;script&gt;bad" in page
    assert "too few inliers &lt;b&gt;&amp;" in page


@pytest.mark.usefixtures("no_plots")
def test_the_page_shows_the_run_s_pictures_with_their_captions(write, tmp_path):
    assert "data:image/jpeg" not in write()
    for name, caption in (("000001", "Scene 1 <b>"), ("000000", "Scene 0")):
        write_case(tmp_path, name, np.zeros((4, 6, 3), np.uint8), caption)
    assert re.findall(r"<figcaption>(.*?)</figcaption>", write()) == ["Scene 0", "Scene 1 &lt;b&gt;"]


def test_the_scenes_that_tell_most_are_the_worst_and_some_of_the_best():
    right = {0: [True, True], 1: [False, False], 2: [True, False], 3: [True, True], 4: [False, True]}
    rows = [
        row.model_copy(update={"success_sym": right[row.scene_id][row.object]})
        for row in make_move_rows("a", 0.5)
        if row.scene_id in right and row.object < 2
    ]
    assert telling_scenes(rows, 8, 2) == [1, 2, 4, 0, 3]
    assert telling_scenes(rows, 3, 1) == [1, 2, 3]


def test_a_page_says_at_once_whether_its_difference_is_shown(write):
    first = re.search(r"<header>.*?</header>", write(0.9, 0.85), re.S)[0]
    assert "&lt;script&gt;bad against good: no difference shown;" in first
    assert "40.0 points worse." in re.search(r"<header>.*?</header>", write(0.9, 0.5), re.S)[0]


def test_many_comparisons_are_counted():
    rows = make_rows("a", 0.9) + make_rows("b", 0.9)
    assert shown_in_words(compare_cells(rows[:60])) == ""
    assert shown_in_words(compare_cells(rows)) == "b against a: the same on every object."
    same = shown_in_words(compare_cells(rows + make_rows("c", 0.9)))
    assert same == "Of 2 comparisons, none shows a difference."
    some = shown_in_words(compare_cells(rows + make_rows("c", 0.2)))
    assert some == "Of 2 comparisons, 1 shows a difference."
    most = shown_in_words(compare_cells(rows + make_rows("c", 0.2) + make_rows("d", 0.1)))
    assert most == "Of 3 comparisons, 2 show a difference."


@pytest.mark.usefixtures("no_plots")
def test_the_headline_is_of_the_best_cell(write):
    done = np.mean([all(row.success for row in make_rows("good", 0.9)[i : i + 3]) for i in range(0, 60, 3)])
    headline = re.search(r"<h1>(.*)</h1>", write())[1]
    assert headline.startswith(("good puts 90% of 60 objects", f"good sets {done:.0%} of 20 scenes right"))


def test_every_page_says_what_goes_wrong_and_how_it_was_made(write, tmp_path):
    settings = "experiment: mine <b>\ncells: []\n"
    (tmp_path / "experiment.resolved.yaml").write_text(settings)
    meta = {"toolkit": "9.9", "commit": "0123456789abcdef", "dirty": True, "started": "2026-01-02", "python": "3.11"}
    (tmp_path / "meta.json").write_text(json.dumps({**meta, "processor": "slow", "cores": 3}))
    page = write()
    assert "<title>mine &lt;b&gt; · toolkit</title>" in page
    assert "toolkit 9.9, commit 0123456789ab with uncommitted changes, 2026-01-02, Python 3.11, slow, 3 cores" in page
    assert escape(settings) in page
    # Of seven names, each stands for eight or nine objects; six in sixty are wrong.
    hardest = re.findall(r"<tr><td>(object_\d)</td><td>(\d)</td><td>(\d)</td>", page)
    assert sum(int(seen) - int(right) for _, right, seen in hardest) == 6
    assert [int(count) for count in re.findall(r"too few inliers &lt;b&gt;&amp;</td><td>(\d+)<", page)] == [36, 6]
    assert page.count("<svg") >= 2 and "objects in the scene" in page and "symmetry of the object" in page


@pytest.mark.usefixtures("no_plots")
def test_the_hardest_objects_have_both_their_errors(tmp_path):
    far = [row.model_copy(update={"translation_error_cm_sym": 8.25, "success_sym": False}) for row in make_rows("a", 1)]
    write_rows(tmp_path / "rows.jsonl", far[:1])
    write_report(tmp_path)
    with (tmp_path / "tables" / "hardest.csv").open() as file:
        (line,) = csv.DictReader(file)
    assert (line["right"], line["seen"]) == ("0", "1")
    assert (float(line["median rotation, deg"]), float(line["median translation, cm"])) == (1.0, 8.25)


@pytest.mark.usefixtures("no_plots")
def test_what_is_all_right_has_nothing_wrong(write):
    page = write(1.0, 1.0)
    assert page.count(">nothing</td>") == 2


@pytest.mark.parametrize("kind", PAGES)
def test_a_page_s_own_template_has_its_own_parts_only(kind):
    """One frame for all: what every page has stands in page.html.j2, and every block of the others is one of its."""
    folder = files("toolkit.results.report")
    frame, own = ((folder / name).read_text() for name in ("page.html.j2", f"{kind}_page.html.j2"))
    assert own.startswith('{% extends "page.html.j2" %}')
    assert not re.search(r"<(html|head|style|main|header|footer)", own)
    blocks = re.findall(r"{% block (\w+) %}", own)
    assert blocks and set(blocks) <= set(re.findall(r"{% block (\w+) %}", frame))


@pytest.mark.parametrize("write_page", [write_report, write_completion_report])
def test_a_run_without_rows_is_said_to_be_so(write_page, tmp_path):
    write_rows(tmp_path / "rows.jsonl", [])
    with pytest.raises(ToolkitError, match="no rows"):
        write_page(tmp_path)


def test_cells_are_compared_on_the_same_scenes_only():
    rows = make_rows("a1", 0.9) + make_rows("a2", 0.5) + make_rows("b1", 0.3, dataset="b")
    (comparison,) = compare_cells(rows)
    assert (comparison.cell, comparison.against) == ("a2", "a1")
    assert comparison.success.mean == pytest.approx(-0.4)
    assert comparison.p < 1e-5 and comparison.verdict == "40.0 points worse"


@pytest.mark.parametrize(("reference", "asked"), [("", ("ba", "ca")), ("b", ("ab", "cb")), ("elsewhere", ("ba", "ca"))])
def test_the_reference_is_chosen_before_the_run_and_p_values_are_adjusted_for_what_is_asked(reference, asked):
    three = make_rows("a", 0.6) + make_rows("b", 0.7) + make_rows("c", 0.9)
    success = {cell: [row.success_sym for row in three if row.cell == cell] for cell in "abc"}
    found = compare_cells(three, reference)
    assert [(c.cell, c.against) for c in found] == [tuple(pair) for pair in asked]
    assert [c.p for c in found] == holm([mcnemar(success[x], success[y]) for x, y in asked])
    assert {c.comparisons for c in found} == {2}
    assert "Holm over 2 comparisons" in comparison_table(found).title


def test_a_named_entry_is_the_reference_in_every_dataset():
    cells = [
        ("one, small", "one", "s"),
        ("two, small", "two", "s"),
        ("one, large", "one", "l"),
        ("two, large", "two", "l"),
    ]
    rows = [
        row.model_copy(update={"settings": {"cell": entry}})
        for cell, entry, dataset in cells
        for row in make_rows(cell, 0.5, dataset=dataset)
    ]
    found = compare_cells(rows, "two")
    assert [(c.cell, c.against) for c in found] == [("one, small", "two, small"), ("one, large", "two, large")]


def test_what_is_not_shown_is_said_with_what_would_show_it():
    rows = make_rows("a", 0.9, scenes=8) + make_rows("b", 0.85, scenes=8)
    (comparison,) = compare_cells(rows)
    assert not comparison.shown
    said = re.fullmatch(
        r"no difference shown; a difference of (\d+) points would most likely have shown; "
        r"if the 4\.2 points seen are real, about (\d+) scenes show it",
        comparison.verdict,
    )
    assert said and int(said[1]) > 4 and int(said[2]) > 8
    small = make_rows("a", 1.0, scenes=2) + make_rows("b", 0.4, scenes=2)
    (few,) = compare_cells(small)
    assert not few.shown and "most likely" in few.verdict
    assert int(re.search(r"about (\d+) scenes", few.verdict)[1]) > 2
    (same,) = compare_cells(make_rows("a", 0.9) + make_rows("b", 0.9))
    assert same.verdict == "the same on every object" and same.p == 1
    (single,) = compare_cells(make_rows("a", 1.0, scenes=1) + make_rows("b", 0.0, scenes=1))
    assert single.verdict == "one scene shows nothing"


def test_a_verdict_says_which_of_interval_and_p_value_shows_nothing():
    (found,) = compare_cells(make_rows("a", 0.9) + make_rows("b", 0.4))
    over_scenes = replace(found, success=replace(found.success, mean=-0.3, interval=(-0.7, 0.0)), p=0.016)
    assert over_scenes.verdict.startswith("not shown over scenes: their interval holds 0")
    over_objects = replace(found, success=replace(found.success, mean=-0.3, interval=(-0.7, -0.1)), p=0.06)
    assert over_objects.verdict.startswith("not shown object by object: p is not below 0.05")


def test_completion_is_compared_by_scene():
    a, b = make_rows("a", 0.9), make_rows("b", 0.5)
    (comparison,) = compare_cells(a + b)
    done = [np.mean([all(r.success_sym for r in c[i : i + 3]) for i in range(0, 60, 3)]) for c in (a, b)]
    assert comparison.completion.mean == pytest.approx(done[1] - done[0])
    by_scene = [[all(r.success_sym for r in c[i : i + 3]) for i in range(0, 60, 3)] for c in (b, a)]
    assert comparison.completion.interval == newcombe_interval(*by_scene)


def test_cells_that_agree_everywhere_are_not_known_to_be_the_same():
    (same,) = compare_cells(make_rows("a", 1.0, scenes=7) + make_rows("b", 1.0, scenes=7))
    for found, pairs in ((same.success, 21), (same.completion, 7)):
        low, high = found.interval
        assert found.mean == 0 and low < 0 < high
        assert (low, high) == pytest.approx(newcombe_interval([True] * pairs, [True] * pairs))


@pytest.mark.parametrize("width", [80, 140])
def test_a_comparison_names_what_it_is_against(width):
    console = Console(width=width, record=True, file=io.StringIO())
    comparison_table(compare_cells(make_rows("the first", 0.9) + make_rows("views=1", 0.5))).print(console)
    text = console.export_text()
    assert "views=1" in text and "Against 'the first'" in text
    assert "-40.0 [" in text and "40.0 points worse" in " ".join(text.split())


def test_the_summary_holds_the_comparisons(tmp_path):
    rows = make_rows("a", 0.9) + make_rows("b", 0.5)
    write_summary(tmp_path / "summary.csv", summary_lines(summarize(rows), compare_cells(rows)))
    first, second = csv.DictReader((tmp_path / "summary.csv").open())
    assert first["against"] == "" and second["against"] == "a"
    assert float(second["against_success"]) == pytest.approx(-0.4)
    assert float(second["against_success_low"]) < -0.4 < float(second["against_success_high"]) < 0


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
    motion_table(summarize(make_rows("rotation_deg=180,views=all", 0.9))).print(console)
    text = console.export_text()
    assert "rotation_deg=180,views=all" in text
    assert "1.00 [1.00, 1.00]" in text and "90% [80, 95]" in text
    assert ("matcher calls" in text) == (width > 110)


@pytest.mark.usefixtures("no_plots")
def test_the_page_comes_with_its_table_as_markdown(tmp_path):
    swept = {"pipeline.views": "all", "dataset.rotation_deg": 180}
    rows = [row.model_copy(update={"settings": swept}) for row in make_rows("rotation_deg=180,views=all", 0.9)]
    write_rows(tmp_path / "rows.jsonl", rows)
    write_report(tmp_path)
    _, _, heading, _, line, paper, *_ = (tmp_path / "summary.md").read_text().splitlines()
    assert heading.startswith("| cell | rotation, deg | p90 |") and "| 90% [80, 95] |" in line
    assert paper.startswith("| *paper, Table I* | *0.25* |  | *0.18* |")
    assert heading.count("|") == line.count("|") == paper.count("|")


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


def test_error_curves_never_turn_back_where_errors_lie_beyond_the_plot():
    rows = [
        row.model_copy(update={"translation_error_cm_sym": 80.0}) if row.success and row.scene_id % 2 else row
        for row in make_rows("a", 0.8)
    ]
    figure = Drawing()
    error_curves(rows, {"a": "#000000"}).draw(figure)
    for axes in figure.axes:
        x, y = axes.lines[0].get_data()
        assert (np.diff(x) >= 0).all() and (np.diff(y) >= 0).all() and x[-1] >= axes.get_xlim()[1]
    nothing = Drawing()
    error_curves(make_rows("a", 0.0), {"a": "#000000"}).draw(nothing)
    assert max(nothing.axes[0].lines[0].get_ydata()) == 0


@pytest.mark.usefixtures("no_plots")
def test_lines_of_the_paper_are_spoken_of_where_there_are_some(tmp_path):
    swept = {"pipeline.views": "all", "dataset.rotation_deg": 180}
    rows = [row.model_copy(update={"settings": swept}) for row in make_rows("a", 0.9)]
    for own, said in ((rows, True), (make_rows("a", 0.9), False)):
        write_rows(tmp_path / "rows.jsonl", own)
        assert ("Lines in italics" in write_report(tmp_path).read_text()) == said


# Tables and plots to print

TABLE = FigureTable(
    "Some & all",
    (Column("cell"), Column("share", name="share, %"), Column("why", kind="words")),
    (
        Line(("a_1", Figure(90.0, (80.0, 95.5), ".0f", "%"), "x < 5°")),
        Line(("a_1", Figure(-3.0, (-7.5, 1.0), "+.1f"), "3-2")),
        Line(("the paper", Figure(float("inf"))), is_paper=True),
    ),
)


def test_a_table_is_the_same_in_every_form():
    assert list(csv.reader(TABLE.csv().splitlines())) == [
        ["cell", "share, %", "share, % low", "share, % high", "why"],
        ["a_1", "90.0", "80.0", "95.5", "x < 5°"],
        ["a_1", "-3.0", "-7.5", "1.0", "3-2"],
        ["the paper", "inf", "", "", ""],
    ]
    assert TABLE.markdown().splitlines()[-3::2] == ["| a_1 | 90% [80, 96] | x < 5° |", "| *the paper* | *∞* |  |"]
    latex, made = TABLE.latex().splitlines(), TABLE.latex("toolkit ablate 'a\nb'").splitlines()
    assert made == [latex[0], "% toolkit ablate 'a b'", *latex[1:]]
    assert latex[2] == r"\begin{tabular}{lrl}" and r"\toprule" in latex
    assert r"a\_1 & 90\% {\scriptsize [80, 96]} & x $<$ 5$^\circ$ \\" in latex
    assert r"\textit{the paper} & \textit{$\infty$} &  \\" in latex
    assert r"a\_1 & $-$3.0 {\scriptsize [$-$7.5, +1.0]} & 3-2 \\" in latex


def test_every_table_and_plot_lies_beside_the_page_and_is_the_same_again(write, tmp_path):
    page = write()
    plots = {path.name for path in (tmp_path / "figures").iterdir()}
    assert {"count.svg", "count.pdf", "symmetry.svg", "symmetry.pdf"} <= plots
    assert page.count("<svg") == len(plots) / 2
    stems = {path.stem for path in (tmp_path / "tables").iterdir()}
    assert {"results", "comparisons", "failures", "hardest"} <= stems
    assert {path.suffix for path in (tmp_path / "tables").iterdir()} == {".csv", ".tex"}
    made = {path: path.read_bytes() for path in tmp_path.rglob("*.*") if path.is_file()}
    assert (
        made[tmp_path / "figures" / "count.pdf"].startswith(b"%PDF") and b"n = " in made[tmp_path / "figures/count.svg"]
    )
    write()
    assert {path: path.read_bytes() for path in tmp_path.rglob("*.*") if path.is_file()} == made


@pytest.mark.usefixtures("no_plots")
def test_the_page_says_what_was_run_and_what_sets_its_cells_apart(write, tmp_path):
    stages = {"matcher": {"name": "sift", "ratio": 0.8}, "views": "all"}
    other = {"matcher": {"name": "loftr", "weights": "outdoor"}, "views": "all"}
    cells = [
        {"cell": "good", "dataset": {"scenes": 20, "light": 1}, "pipeline": stages},
        {"cell": "<script>bad", "dataset": {"scenes": 20, "light": 1}, "pipeline": other},
    ]
    (tmp_path / "experiment.resolved.yaml").write_text(yaml.safe_dump({"experiment": "mine", "cells": cells}))
    about = {"title": "Two matchers", "description": "Which is better?", "reference": "<script>bad"}
    meta = dict.fromkeys(("toolkit", "commit", "dirty", "started", "python", "processor", "cores"), "")
    meta |= {"experiment": about, "command": ["/bin/toolkit", "ablate", "my file"]}
    (tmp_path / "meta.json").write_text(json.dumps(meta))
    page = write()
    assert "Two matchers" in page and "Which is better?" in page and "toolkit ablate &#39;my file&#39;" in page
    assert "<dt>scenes</dt><dd>20</dd>" in page and "<dt>views</dt><dd>all</dd>" in page
    assert "<dt>light</dt>" not in page
    assert "matcher sift</td>" in page and "matcher loftr; matcher.weights outdoor</td>" in page  # a ratio says nothing
    assert "good" in (tmp_path / "tables" / "comparisons.csv").read_text().splitlines()[1].split(",")[0]
