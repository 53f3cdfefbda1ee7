"""The command line as a user meets it: exit codes, one-sentence answers, files written."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys

import cv2
import numpy as np
import pytest
from command_line import own_process, toolkit

from toolkit import __version__
from toolkit.cli import commands, doctor
from toolkit.data.bop import load_capture
from toolkit.data.clouds import read_cloud
from toolkit.data.scene import TabletopConfig
from toolkit.errors import ToolkitError
from toolkit.geometry import invert, transform_points
from toolkit.harness.experiment import PipelineChoice, RearrangeChoice, load_experiment
from toolkit.harness.runs import read_cells
from toolkit.results.about import About
from toolkit.results.poses import read_poses
from toolkit.results.rows import read_rows
from toolkit.settings import shipped_settings
from toolkit.stages import REGISTRIES
from toolkit.weights.cards import CARDS

FEW = ["--scenes", "1", "--set", "dataset.views=2", "--set", "dataset.max_objects=2"]
MISTAKES = {
    "unknown experiment": (["ablate", "quik"], "did you mean 'quick'?"),
    "unknown stage name": (["ablate", "--matcher", "sfit"], "unknown matcher 'sfit'; did you mean 'sift'?"),
    "several names at once": (["ablate", "--goal-segmenter", "oracle, masks"], "oracle --goal-segmenter masks"),
    "unknown setting": (["ablate", "--set", "pipeline.matcher.ratoi=0.8"], "did you mean 'ratio'?"),
    "unknown path": (["ablate", "--set", "pipelin.views=1"], "did you mean 'pipeline'?"),
    "a --set without a value": (["ablate", "--set", "pipeline.views"], "--set takes path.to.key=value"),
    "a value that does not fit": (["ablate", "--set", "pipeline.min_matches=two"], "min_matches"),
    "too many views": (["ablate", *FEW, "--set", "pipeline.views=3"], "a scene has 2 frames"),
    "no views": (["ablate", "--set", "pipeline.views=0"], "at least one current frame is needed"),
    "a folder that cannot be made": (["plugin", "new", "matcher", "mine", "--out", "/sys/mine"], "cannot be written"),
    "a file for a folder": (["dataset", "build", f"{__file__}/d", "--scenes", "1"], "cannot be written"),
    "no such object folder": (["ablate", "--objects", "nowhere"], "is not a folder"),
    "too many objects": (["ablate", "--set", "dataset.max_objects=200"], "max_objects is 200"),
    "a track for its effects": (["ablate", "--set", "dataset.noise=d435"], "--set dataset.track=d435"),
    "no such plugin": (["ablate", "--plugin", "nowhere.py"], "does not exist"),
    "no such capture": (["estimate", "nowhere"], "does not exist"),
    "a sweep for estimate": (["estimate", "x", "--matcher", "sift", "--matcher", "loftr"], "use `toolkit ablate`"),
    "no such run": (["report", "nowhere"], "is not a run folder"),
    "no such run to view": (["view", "nowhere"], "neither a run folder (with rows.jsonl) nor a capture folder"),
    "unknown stage": (["list", "matchr"], "did you mean 'matcher'?"),
    "unknown implementation": (["show", "matcher", "lofter"], "did you mean 'loftr'?"),
    "no implementation to show": (["show", "matcher"], "say which matcher: "),
    "nothing of that kind to show": (["show", "datset"], "did you mean 'dataset'?"),
    "an implementation of no stage": (["show", "dataset", "sift"], "leave 'sift' out"),
    "a sweep to attribute": (["ablate", "quick", "--attribute"], "attribution takes one setting"),
    "a new plugin for no stage": (["plugin", "new", "matchr", "mine"], "did you mean 'matcher'?"),
    "a new plugin with a name taken": (["plugin", "new", "matcher", "sift"], "there is a matcher 'sift' already"),
    "a check of nothing": (["check", "matcher", "lofter"], "did you mean 'loftr'?"),
    "several values where one is set": (["check", "index", "numpy", "--set", "a=1,2"], "--set a takes one value here"),
    "no such kind to import": (["capture", "import", "tumm", "x", "y", "--goal", "0"], "did you mean 'tum'?"),
    "an unknown setting of a kind": (
        ["capture", "import", "ros", "x", "y", "--goal", "0", "--set", "colour=/a"],
        "unknown setting 'colour'; did you mean 'color'?",
    ),
    "a setting that a kind needs": (["capture", "import", "colmap", "x", "y", "--goal", "0"], "'scale'"),
    "no such kind to export": (["export", "csv", "x", "y"], "unknown export kind 'csv'"),
    "nothing to export": (["export", "ply", "nowhere", "y"], "'nowhere' holds no poses.json"),
    "no such list": (["list", "experiment"], "did you mean 'experiments'?"),
    "no such dataset": (["dataset", "show", "nowhere"], "nowhere"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_mistakes_are_answered_in_a_line_or_two(case, tmp_path):
    arguments, said = MISTAKES[case]
    done = toolkit(*arguments, folder=tmp_path)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    error = done.stderr[done.stderr.index("error: ") :]
    assert said in error
    assert len(error.strip().splitlines()) <= 2


def test_yaml_that_does_not_parse_is_named_with_its_line(tmp_path):
    (tmp_path / "bad.yaml").write_text("name: x\npipeline: {matcher: sift\nseed: 3\n")
    done = own_process("ablate", "bad.yaml", folder=tmp_path)
    assert done.returncode == 2
    assert re.search(r"error: experiment 'bad\.yaml', line \d+: ", done.stderr)


def test_every_implementation_is_listed_and_shown():
    listed = toolkit("list")
    assert listed.returncode == 0
    for name in ("oracle", "depth_plane", "kmeans", "color_hist", "faiss", "instance_vote", "sift", "jax_ransac"):
        assert name in listed.stdout
    assert "cannot be used" not in listed.stdout
    shown = toolkit("show", "matcher", "sift")
    assert "ratio" in shown.stdout and "RootSIFT" in shown.stdout and "weights" not in shown.stdout
    assert "non-commercial" in toolkit("show", "grasp", "contact_graspnet").stdout


def test_every_shipped_experiment_is_listed_with_its_description_and_file():
    listed = toolkit("list", "experiments", COLUMNS="300")
    assert listed.returncode == 0, listed.stderr
    lines = [[cell.strip() for cell in line.split("│")[1:-1]] for line in listed.stdout.splitlines() if "│" in line]
    shipped = shipped_settings()
    assert lines == [[name, load_experiment(name).description, path.name] for name, path in shipped.items()]
    assert str(shipped["quick"].parent) in listed.stdout


PARTS = {"dataset": TabletopConfig, "pipeline": PipelineChoice, "rearrange": RearrangeChoice}


@pytest.mark.parametrize("part", PARTS)
def test_every_setting_of_a_part_is_shown_with_its_meaning(part):
    shown = toolkit("show", part, COLUMNS="80")
    assert shown.returncode == 0, shown.stderr
    lines = [[cell.strip() for cell in line.split("│")[1:-1]] for line in shown.stdout.splitlines() if "│" in line]
    assert [name for name, _, _ in lines if name] == list(PARTS[part].model_fields)
    assert all(meaning for _, _, meaning in lines)
    assert max(map(len, shown.stdout.splitlines()[1:])) <= 80


@pytest.mark.parametrize("what", [["list"], ["list", "experiments"], ["weights", "list"]])
def test_no_table_breaks_a_name(what):
    names = {
        "list": [entry.name for registry in REGISTRIES.values() for entry in registry.entries()],
        "experiments": list(shipped_settings()),
        "weights": list(CARDS),
    }
    shown = toolkit(*what, COLUMNS="80").stdout
    words = set(re.findall(r"[\w.-]+", shown))
    assert words >= set(names["weights" if what[0] == "weights" else what[-1]])


def test_the_list_of_weights_breaks_no_word():
    shown = set(toolkit("weights", "list", COLUMNS="80").stdout.split())
    assert {word for card in CARDS.values() for word in (card.architecture + " " + card.licence).split()} <= shown


@pytest.mark.parametrize("command", ["ablate", "rearrange", "estimate", "evaluate", "plan", "serve"])
def test_help_fits_a_screen(command):
    lines = toolkit(command, "--help", COLUMNS="80").stdout.rstrip().splitlines()
    assert len(lines) <= 50 and max(map(len, lines)) <= 80
    assert any("--goal-segmenter" in line for line in lines)
    # Several values make several cells, which only these two run.
    assert ("sweep" in " ".join(lines)) == ("swept" in " ".join(lines)) == (command in ("ablate", "rearrange"))


def test_the_version_is_said_without_a_command():
    done = toolkit("--version")
    assert (done.returncode, done.stdout) == (0, f"toolkit {__version__}\n")


COMPLETIONS = {
    "ablate pap": {"paper", "paper_official", "paper_quick", "paper_table1", "paper_table2"},
    "ablate --matcher si": {"sift"},
    "ablate --goal-segmenter or": {"oracle"},
    "rearrange --planner op": {"optimal"},
    "show mat": {"matcher"},
    "show matcher xf": {"xfeat_lighterglue", "xfeat_star"},
    "list ex": {"executor", "experiments", "explainer"},
    "view somewhere --experiment qu": {"quick"},
}


@pytest.mark.parametrize("line", COMPLETIONS)
def test_the_shell_completes_names(line):
    words = ["toolkit", *line.split(" ")]
    asked = {"_TOOLKIT_COMPLETE": "complete_bash", "COMP_WORDS": " ".join(words), "COMP_CWORD": str(len(words) - 1)}
    assert set(own_process(**asked).stdout.split()) == COMPLETIONS[line]


def test_a_broken_plugin_is_marked_and_breaks_nothing_else(tmp_path):
    info = tmp_path / "broken-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[toolkit.matchers]\nbad = no_such_module:Matcher\n")
    done = subprocess.run(
        [sys.executable, "-P", "-c", "from toolkit.cli.commands import main; main()", "list", "matcher"],
        env={**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}", "COLUMNS": "200"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "cannot be used" in done.stdout and "RootSIFT" in done.stdout


def test_doctor_says_what_the_machine_has():
    done = own_process("doctor")
    assert done.returncode == 0
    for word in (
        f"cv2 {cv2.__version__}",
        "torch's devices: cpu",
        "JAX's devices: ",
        "cores:",
        "torch",
        "renderer:",
        "cache:",
    ):
        assert word in done.stdout


def test_doctor_names_two_opencvs_in_one_environment(monkeypatch):
    there = {"opencv-python": "4.10", "opencv-python-headless": "5.0"}

    def version(name):
        if name not in there:
            raise doctor.PackageNotFoundError(name)
        return there[name]

    monkeypatch.setattr(doctor, "version", version)
    (finding,) = doctor._opencvs()
    assert finding.startswith("broken: opencv-python 4.10 and opencv-python-headless 5.0 overwrite each other")
    del there["opencv-python"]
    assert not list(doctor._opencvs())


def test_estimate_writes_poses_masks_and_pictures(dataset, tmp_path):
    done = toolkit("estimate", dataset / "000000", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    poses = json.loads((tmp_path / "out" / "poses.json").read_text())
    assert poses["schema"] == 2 and poses["capture"] == "000000"
    assert len(poses["objects"]) == 3
    for entry in poses["objects"]:
        assert set(entry) == {
            *("goal_object", "bbox_xyxy", "mask", "instance", "status", "T_goal_current"),
            *("confidence", "equivalents", "ambiguity", "covariance", "stage", "reason", "time_ms"),
        }
        mask = cv2.imread(str(tmp_path / "out" / entry["mask"]), cv2.IMREAD_GRAYSCALE)
        x0, y0, x1, y1 = entry["bbox_xyxy"]
        assert mask.shape == (480, 640) and mask[y0 : y1 + 1, x0 : x1 + 1].any()
        assert (entry["T_goal_current"] is None) == (entry["status"] != "estimated")
    for instance in read_poses(tmp_path / "out" / "poses.json").instances:
        points, _ = read_cloud(tmp_path / "out" / instance.model)
        local = transform_points(invert(np.array(instance.T_world_box)), points)
        assert (np.abs(local) <= np.array(instance.size) / 2 + 1e-4).all()
    assert poses["not_in_goal"] == poses["not_in_current"] == []
    picture = cv2.imread(str(tmp_path / "out" / "overlay.png"))
    goal = cv2.imread(str(dataset / "000000" / "goal" / "rgb" / "000000.png"))
    assert picture.shape[1:] == goal.shape[1:] and (picture[: len(goal)] != goal).any()
    assert poses["findings"] == []
    assert "confidence" in done.stdout and "overlay.png" in done.stdout
    for kind, options in (("bop", ["--set", f"captures={dataset / '000000'}"]), ("ply", []), ("ros", [])):
        exported = toolkit("export", kind, tmp_path / "out", tmp_path / kind, *options)
        assert exported.returncode == 0 and f"Written: {tmp_path / kind}" in exported.stdout, exported.stderr
    moved = sum(entry["T_goal_current"] is not None for entry in poses["objects"])
    assert len((tmp_path / "bop").read_text().splitlines()) == 1 + moved
    assert len(list((tmp_path / "ply").iterdir())) == len(poses["instances"])
    assert sum(o["goal"] is not None for o in json.loads((tmp_path / "ros").read_text())["objects"]) == moved
    assert list((tmp_path / "out").glob("matches_*.png"))


def test_estimate_needs_no_truth(capture_copy, tmp_path):
    for scene in ("current", "goal"):
        (capture_copy / scene / "scene_gt.json").unlink()
        shutil.rmtree(capture_copy / scene / "mask_visib")
    (capture_copy / "models_info.json").unlink()
    done = toolkit("estimate", capture_copy, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert any(o["status"] == "estimated" for o in json.loads((tmp_path / "out" / "poses.json").read_text())["objects"])


def test_own_masks_need_no_segmenter_and_what_is_left_out_is_said(capture_copy, tmp_path):
    masks = tmp_path / "masks"
    for scene in ("current", "goal"):
        (capture_copy / scene / "scene_gt.json").unlink()
        shutil.move(capture_copy / scene / "mask_visib", masks / scene)
    (capture_copy / "current/depth/000001.png").unlink()
    quick = ["--refiner", "none", "--pnp", "poselib", "--set", "pipeline.assignment=vote"]
    done = toolkit("estimate", capture_copy, "--masks", masks, *quick, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert "current frame 1 is left out: " in done.stderr and "000001.png' is missing" in done.stderr
    written = json.loads((tmp_path / "out" / "poses.json").read_text())["objects"]
    own = sorted(path.read_bytes() for path in (masks / "goal").iterdir())
    areas = [sorted(int((cv2.imdecode(np.frombuffer(data, np.uint8), -1) > 0).sum()) for data in own)]
    found = [(cv2.imread(str(tmp_path / "out" / entry["mask"]), -1) > 0).sum() for entry in written]
    assert sorted(map(int, found)) == [area for area in areas[0] if area]


def test_the_oracle_without_truth_is_a_users_mistake(capture_copy, tmp_path):
    for scene in ("current", "goal"):
        (capture_copy / scene / "scene_gt.json").unlink()
        shutil.rmtree(capture_copy / scene / "mask_visib")
    done = toolkit("estimate", capture_copy, "--segmenter", "oracle", "--out", tmp_path / "out")
    assert done.returncode == 2 and done.stderr.startswith("error: ")
    assert not (tmp_path / "out").exists()


def test_a_recording_is_imported_and_checked(dataset, tmp_path):
    scenes = [dataset / "000000" / name for name in ("current", "goal")]
    chosen = ["--goal", "0", "--goal-source", scenes[1], "--frames", "0:3"]
    done = toolkit("capture", "import", "bop", scenes[0], tmp_path / "out", *chosen)
    assert done.returncode == 0, done.stderr
    assert f"Next: toolkit capture check {tmp_path / 'out'}" in done.stdout
    (same, original) = map(load_capture, (tmp_path / "out", dataset / "000000"))
    assert [frame.index for frame in same.current] == [0, 1, 2] and same.truth.keys() == original.truth.keys()
    assert toolkit("capture", "check", tmp_path / "out").returncode == 0
    again = toolkit("capture", "import", "bop", scenes[0], tmp_path / "out", *chosen)
    assert again.returncode == 2 and "is there already" in again.stderr


def test_recording_needs_a_camera(tmp_path):
    pytest.importorskip("pyrealsense2", exc_type=ImportError)  # the system may lack libusb
    done = toolkit("capture", "record", tmp_path / "out", "--hand-eye", "0 0 0 0 0 0 1")
    assert done.returncode == 2 and "the RealSense camera cannot be opened" in done.stderr
    done = toolkit("capture", "record", tmp_path / "out", "--hand-eye", "0 0 0")
    assert done.returncode == 2 and "--hand-eye must be `x y z qx qy qz qw`" in done.stderr


def test_evaluate_scores_a_folder_of_captures(dataset, tmp_path):
    done = toolkit("evaluate", dataset, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    rows = read_rows(tmp_path / "out" / "rows.jsonl")
    assert {row.scene for row in rows} == {"000000", "000001"} and len(rows) == 6
    assert sum(row.success_sym for row in rows) >= 2
    assert (tmp_path / "out" / "000001" / "poses.json").is_file()
    assert "5 deg 2 cm" in done.stdout
    about = About.read(tmp_path / "out")
    assert about.title == f"Captures of {dataset.name}" and about.command.startswith("toolkit evaluate")
    (cell,) = read_cells(tmp_path / "out")
    assert cell.dataset == {"path": str(dataset)} and cell.pipeline.matcher.name == "sift"


def in_opengls_axes(capture):
    """Write both scenes' poses with y up and z backwards, as renderers have them."""
    for scene in ("current", "goal"):
        path = capture / scene / "scene_camera.json"
        cameras = json.loads(path.read_text())
        for entry in cameras.values():
            R, t = np.reshape(entry["cam_R_w2c"], (3, 3)), np.ravel(entry["cam_t_w2c"])
            entry["cam_R_w2c"] = (np.diag([1, -1, -1]) @ R).ravel().tolist()
            entry["cam_t_w2c"] = (np.diag([1, -1, -1]) @ t).tolist()
        path.write_text(json.dumps(cameras))


def test_a_capture_is_checked(dataset, capture_copy, tmp_path):
    done = toolkit("capture", "check", dataset / "000000")
    assert done.returncode == 0, done.stderr
    assert "nothing is wrong" in done.stdout
    in_opengls_axes(capture_copy)
    for command, out in ((["capture", "check"], "checked"), (["estimate"], "out")):
        done = toolkit(*command, capture_copy, "--out", tmp_path / out)
        assert done.returncode == 2
        assert "OpenGL" in done.stderr and done.stderr.strip().splitlines()[-1].startswith("error: ")
    assert not (tmp_path / "out" / "poses.json").exists()


def test_what_is_refused_counts_as_missed_in_an_evaluation(capture_copy, tmp_path):
    in_opengls_axes(capture_copy)
    folder = tmp_path / "several"
    shutil.move(capture_copy, folder / "000000")
    done = toolkit("evaluate", folder, "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr
    assert "OpenGL" in done.stderr
    rows = read_rows(tmp_path / "out" / "rows.jsonl")
    assert rows and {row.status for row in rows} == {"missed"}


def test_nothing_found_is_a_sentence_and_exit_1(capture_copy, tmp_path):
    for path in (capture_copy / "goal" / "rgb").iterdir():
        picture = cv2.imread(str(path))
        cv2.imwrite(str(path), np.full_like(picture, 2))
    done = toolkit("estimate", capture_copy, "--out", tmp_path / "out")
    assert done.returncode == 1, done.stderr
    assert "nearly black" in done.stdout
    assert done.stderr.strip().splitlines()[-1].startswith("no motion")


def test_datasets_are_built_and_shown(tmp_path):
    built = toolkit("dataset", "build", tmp_path / "d", "--scenes", 1, "--set", "views=2", "--set", "max_objects=2")
    assert built.returncode == 0, built.stderr
    one = toolkit("dataset", "show", tmp_path / "d" / "000000")
    assert one.returncode == 2 and "is one capture" in one.stderr
    several = toolkit("estimate", tmp_path / "d")
    assert several.returncode == 2 and "d/000000', or all: toolkit evaluate " in several.stderr
    (tmp_path / "own").mkdir()
    shutil.copytree(tmp_path / "d" / "000000", tmp_path / "own" / "mine")
    (tmp_path / "own" / "mine" / "models_info.json").unlink()
    assert "captures: 1\nwithout truth" in toolkit("dataset", "show", tmp_path / "own").stdout
    shown = toolkit("dataset", "show", tmp_path / "d")
    assert "captures: 1" in shown.stdout and "rendered by PyBullet" in shown.stdout
    assert (tmp_path / "d" / "overview.png").is_file()


@pytest.mark.parametrize(("command", "resumes"), [("plan", False), ("estimate", False), ("ablate", True)])
def test_ctrl_c_names_resume_where_it_is_an_option(command, resumes, monkeypatch, capsys):
    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(sys, "argv", ["toolkit", command])
    monkeypatch.setattr(commands, "app", lambda: signal.raise_signal(signal.SIGINT))
    try:
        with pytest.raises(SystemExit) as end:
            commands.main()
    finally:
        signal.signal(signal.SIGINT, before)
    said = capsys.readouterr().err
    assert end.value.code == 130 and said.startswith("stopped") and ("--resume" in said) == resumes


def test_ctrl_c_in_an_import_is_no_fault_of_what_is_imported(monkeypatch, capsys):
    def broken_off():
        try:
            signal.raise_signal(signal.SIGINT)
        except BaseException as error:
            raise ToolkitError("segmenter 'multiview' cannot be loaded") from error

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(sys, "argv", ["toolkit", "estimate"])
    monkeypatch.setattr(commands, "app", broken_off)
    try:
        with pytest.raises(SystemExit) as end:
            commands.main()
    finally:
        signal.signal(signal.SIGINT, before)
    assert end.value.code == 130 and capsys.readouterr().err == "stopped\n"
