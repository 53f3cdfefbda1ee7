from __future__ import annotations

import textwrap

import pytest

from toolkit.errors import ToolkitError
from toolkit.harness.experiment import Cell, expand, load_experiment
from toolkit.settings import parse_set, shipped_settings

BASE = """
name: mine
dataset: {objects: procedural, scenes: 2}
pipeline:
  segmenter: oracle
  goal_segmenter: oracle
  associator: oracle
  descriptor: hog
  index: numpy
  retriever: instance_vote
  matcher: {name: sift, ratio: 0.9}
  pnp: poselib
"""


@pytest.fixture
def write(tmp_path):
    def _write(text):
        path = tmp_path / "mine.yaml"
        path.write_text(textwrap.dedent(text))
        return str(path)

    return _write


@pytest.mark.parametrize("name", list(shipped_settings()))
def test_shipped_experiments_are_valid(name):
    assert load_experiment(name).name == name
    assert expand(load_experiment(name))


def test_an_option_given_twice_sweeps_and_once_replaces(write):
    path = write(BASE)
    overrides = {"pipeline.pnp": ["poselib", "opencv_epnp"], "pipeline.descriptor": ["color_hist"]}
    cells = expand(load_experiment(path, overrides))
    assert [cell.name for cell in cells] == ["pnp=poselib", "pnp=opencv_epnp"]
    assert {cell.pipeline.descriptor.name for cell in cells} == {"color_hist"}


def test_two_sweeps_make_a_product():
    overrides = {"pipeline.matcher": ["sift", "loftr"], "pipeline.pnp": ["poselib", "jax_ransac"]}
    experiment = load_experiment("matchers", overrides)
    assert len(expand(experiment)) == 4


def test_settings_stay_with_their_implementation(write):
    path = write(BASE)
    (same,) = expand(load_experiment(path, {"pipeline.matcher": ["sift"]}))
    assert same.resolved()["pipeline"]["matcher"]["ratio"] == 0.9
    (changed,) = expand(load_experiment(path, {"pipeline.matcher.ratio": [0.7]}))
    assert changed.resolved()["pipeline"]["matcher"]["ratio"] == 0.7
    (deep,) = expand(load_experiment(path, {"pipeline.retriever.top_k": [3]}))
    assert deep.resolved()["pipeline"]["retriever"]["top_k"] == 3


REARRANGED = BASE + "rearrange: {executor: arm}\n"


def executor(path, **overrides):
    (cell,) = expand(load_experiment(path, {f"rearrange.executor.{key}": [value] for key, value in overrides.items()}))
    return cell.resolved()["rearrange"]["executor"]


def test_a_stage_that_another_works_with_is_chosen_as_every_other(write):
    path = write(REARRANGED)
    plain = executor(path)
    assert plain["grasp"]["name"] == "antipodal" and plain["grasp"]["friction"] == 0.4
    assert plain["motion"]["name"] == "roboplan"
    assert executor(path, grasp="antipodal") == executor(path, **{"grasp.name": "antipodal"}) == plain
    deep = executor(path, **{"grasp.friction": 0.3})
    assert deep == plain | {"grasp": plain["grasp"] | {"friction": 0.3}}
    assert executor(path, **{"grasp.friction": 0.3, "grasp.name": "antipodal"}) == deep
    other = executor(path, **{"grasp.name": "contact_graspnet", "grasp.least_score": 0.3})
    assert other["grasp"]["name"] == "contact_graspnet" and other["grasp"]["least_score"] == 0.3
    with_settings = REARRANGED.replace("arm", "{name: arm, grasp: {name: antipodal, friction: 0.3}}")
    assert executor(write(with_settings))["grasp"]["friction"] == 0.3
    changed = executor(write(with_settings), **{"grasp.name": "contact_graspnet"})
    assert changed["grasp"]["name"] == "contact_graspnet"


def test_a_stage_that_another_works_with_sweeps(write):
    swept = {"rearrange.executor.grasp.name": ["antipodal", "contact_graspnet"]}
    cells = expand(load_experiment(write(REARRANGED), swept))
    assert [cell.name for cell in cells] == ["executor.grasp=antipodal", "executor.grasp=contact_graspnet"]
    assert [cell.rearrange.executor.settings["grasp"] for cell in cells] == ["antipodal", "contact_graspnet"]
    assert [Cell.read(cell.resolved()).resolved() for cell in cells] == [cell.resolved() for cell in cells]


def test_every_default_is_written_out(write):
    (cell,) = expand(load_experiment(write(BASE)))
    resolved = cell.resolved()
    assert resolved["pipeline"]["pnp"]["reprojection_px"] > 0
    assert resolved["pipeline"]["fuse"] == "all" and resolved["dataset"]["views"] == 8


def test_named_cells_multiply_with_the_sweep(write):
    text = BASE + "cells:\n- {name: a}\n- {name: b, set: {pipeline.fuse: first}}\nsweep: {pipeline.views: [all, 1]}\n"
    cells = expand(load_experiment(write(text)))
    assert [c.name for c in cells] == ["a, views=all", "a, views=1", "b, views=all", "b, views=1"]
    assert [c.pipeline.fuse for c in cells] == ["all", "all", "first", "first"]


def test_the_paper_s_rival_is_what_estimate_runs():
    (estimate,) = expand(load_experiment("estimate"))
    ours = [cell for cell in expand(load_experiment("paper")) if cell.name.startswith("ours")]
    assert len(ours) == 2
    assert all(cell.resolved()["pipeline"] == estimate.resolved()["pipeline"] for cell in ours)


def test_a_choice_of_the_command_line_holds_in_every_cell():
    for choice in ({"pipeline.segmenter": ["oracle"]}, {"pipeline.segmenter.name": ["oracle"]}):
        assert {cell.pipeline.segmenter.name for cell in expand(load_experiment("paper", choice))} == {"oracle"}
    refined = expand(load_experiment("beyond_paper", {"pipeline.refiner": ["none"]}))
    assert {cell.pipeline.refiner.name for cell in refined} == {"none"}


def test_the_short_story_is_the_paper_s_without_a_download():
    long = {cell.name: cell.resolved()["pipeline"] for cell in expand(load_experiment("paper"))}
    for cell in expand(load_experiment("paper_quick")):
        own, other = cell.resolved()["pipeline"], long[f"{cell.name}, ±180°"]
        assert {key for key in own if own[key] != other[key]} <= {"descriptor"}


def test_official_weights_are_all_that_sets_the_official_experiment_apart():
    official = {cell.name: cell.resolved() for cell in expand(load_experiment("paper_official"))}
    shipped = {cell.name: cell.resolved() for cell in expand(load_experiment("paper"))}
    for name, cell in official.items():
        own, other = cell["pipeline"], shipped[f"paper, {name}"]["pipeline"]
        assert cell["dataset"] == shipped[f"paper, {name}"]["dataset"]
        assert {key for key in own if own[key] != other[key]} == {
            "segmenter",
            "goal_segmenter",
            "descriptor",
            "matcher",
        }
        assert (own["descriptor"]["name"], own["matcher"]["name"]) == ("mixvpr", "loftr")


def test_values_have_the_names_that_people_give_them(write):
    text = BASE + "sweep: {pipeline.views: [{name: multi-view, value: all}, 1], pipeline.pnp: [{name: poselib}]}\n"
    cells = expand(load_experiment(write(text)))
    assert [c.name for c in cells] == ["multi-view, pnp=poselib", "views=1, pnp=poselib"]
    assert [c.settings["pipeline.views"] for c in cells] == ["all", 1]
    assert [c.pipeline.views for c in cells] == ["all", 1]
    (kept,) = expand(load_experiment(write(text), {"dataset.scenes": [3], "pipeline.views": [2]}))
    assert kept.pipeline.views == 2
    replaced = expand(load_experiment(write(text), {"dataset.rotation_deg": [60, 180]}))
    assert [c.pipeline.views for c in replaced] == ["all", "all"]


def test_a_changed_experiment_says_so_in_its_title(write):
    text = BASE + "title: Views\ndescription: What they do.\nsweep: {pipeline.views: [all, 1]}\n"
    assert load_experiment(write(text)).title == "Views"
    fewer = load_experiment(write(text), {"dataset.scenes": [3]})
    assert (fewer.title, fewer.description) == ("Views", "What they do. Changed: scenes 3.")
    other = load_experiment(write(text), {"dataset.scenes": [3], "pipeline.pnp": ["poselib", "jax_ransac"]})
    assert other.title == "pnp: poselib or jax_ransac"
    assert other.description == "With the settings of 'mine'. Changed: scenes 3."


def test_the_reference_is_one_of_the_cells(write):
    cells = "cells:\n- {name: a}\n- {name: b, set: {pipeline.fuse: first}}\nsweep: {pipeline.views: [all, 1]}\n"
    for reference in ("b", "'b, views=1'"):
        expand(load_experiment(write(BASE + cells + f"reference: {reference}\n")))
    with pytest.raises(ToolkitError, match="reference 'c' is none of the cells"):
        expand(load_experiment(write(BASE + cells + "reference: c\n")))


@pytest.mark.parametrize(
    ("text", "overrides", "said"),
    [
        (BASE + "  pnp: [", {}, r"mine.yaml', line \d+"),
        ("- a list", {}, "must be a mapping"),
        (BASE + "sceens: 3\n", {}, "unknown setting 'sceens'"),
        (BASE + "sweep:\n", {"pipeline.matcher": ["sift"]}, "setting 'sweep'"),
        (BASE, {"pipeline.matcher": ["sfit"]}, "unknown matcher 'sfit'; did you mean 'sift'"),
        (REARRANGED, {"rearrange.executor.grasp": ["antipodl"]}, "unknown grasp 'antipodl'; did you mean 'antipodal'"),
        (REARRANGED, {"rearrange.executor.grasp.fricton": [1]}, "grasp 'antipodal': unknown setting 'fricton'; did"),
        (REARRANGED, {"rearrange.executor.grap.name": ["a"]}, "executor 'arm': unknown setting 'grap'; did you mean"),
        (REARRANGED, {"rearrange.executor.grasp": [3]}, "grasp: Input should be a valid dictionary"),
        (BASE, {"pipeline.matchr": ["sift"]}, "unknown setting 'matchr'; did you mean 'matcher'"),
        (BASE, {"pipeline.matcher.ratoi": [1]}, "unknown setting 'ratoi'; did you mean 'ratio'"),
        (BASE, {"dataset.scene": [1]}, "dataset: unknown setting 'scene'; did you mean 'scenes'"),
        (BASE, {"pipelin.fuse": ["all"]}, "there is no 'pipelin'; did you mean 'pipeline'"),
        (BASE, {"track": ["d435"]}, "there is no 'track'; did you mean 'dataset.track'"),
        (BASE, {"matcher.ratio": [0.8]}, "there is no 'matcher'; did you mean 'pipeline.matcher.ratio'"),
        (BASE, {"planner": ["paper"]}, "there is no 'planner'; did you mean 'rearrange.planner'"),
        (BASE, {"pipeline.matcher": ["SIFT"]}, "unknown matcher 'SIFT'; did you mean 'sift'"),
        (BASE, {"pipeline.fuse": ["some"]}, "pipeline: setting 'fuse'"),
        (BASE, {"pipeline.pnp": ["poselib", "poselib"]}, "two cells are called 'pnp=poselib'"),
        (BASE.replace("name: mine", "name: a/b"), {}, "name"),
    ],
)
def test_mistakes_are_answered_in_one_sentence(write, text, overrides, said):
    with pytest.raises(ToolkitError, match=said) as error:
        expand(load_experiment(write(text), overrides))
    assert "\n" not in str(error.value)


def test_an_unknown_experiment_is_answered_with_the_nearest(tmp_path):
    with pytest.raises(ToolkitError, match="did you mean 'quick'"):
        load_experiment("quikc")
    with pytest.raises(ToolkitError, match="cannot be read"):
        load_experiment(str(tmp_path / "absent.yaml"))


def test_a_file_that_is_no_text_is_one_sentence(tmp_path):
    (tmp_path / "binary.yaml").write_bytes(b"\x89PNG\x00\xff")
    with pytest.raises(ToolkitError, match="not YAML") as error:
        load_experiment(str(tmp_path / "binary.yaml"))
    assert "\n" not in str(error.value)


def test_set_options_are_yaml():
    assert parse_set("pipeline.views=all,1") == ("pipeline.views", ["all", 1])
    assert parse_set("a.b=0.5") == ("a.b", [0.5])
    assert parse_set("noise=[depth,light],[pose]") == ("noise", [["depth", "light"], ["pose"]])
    for bad in ("pipeline.views", "=3", "a="):
        with pytest.raises(ToolkitError, match="--set takes"):
            parse_set(bad)
