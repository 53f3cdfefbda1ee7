"""Training: exact correspondences, the losses by their definitions, and runs that repeat and resume to the bit."""

from __future__ import annotations

import csv
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml
from safetensors.torch import load_file
from typer.testing import CliRunner

from toolkit.cli.commands import app
from toolkit.data.procedural import write_set
from toolkit.data.procedural.families import FAMILIES
from toolkit.errors import ToolkitError
from toolkit.models.efficientnet_lite import EfficientNetLite0
from toolkit.models.loftr_small import make_loftr_small
from toolkit.models.mixvpr import mixer_lite
from toolkit.perception.crops import crop_region
from toolkit.progress import Progress
from toolkit.stages import MATCHERS
from toolkit.training.config import LoftrTraining, MixvprTraining
from toolkit.training.export import export
from toolkit.training.loftr_loss import coarse_log_confidence, fine_loss, focal_loss
from toolkit.training.multi_similarity import ALPHA, BETA, MARGIN, multi_similarity
from toolkit.training.pairs import PairsConfig, PairSource, _carry, augmented_crop, cell_centers, relate
from toolkit.training.pool import PoolConfig, is_held_out, procedural_pool
from toolkit.training.run import TrainOptions, read_training, train
from toolkit.types import Segment
from toolkit.weights.cards import CARDS
from toolkit.weights.load import fill, read_tensors
from toolkit.weights.resolve import file_digest, resolve_weights
from toolkit.weights.sources import SHIPPED

POOL = {"objects_per_family": 2, "objects_per_scene": 8, "frames": 3, "renderer": "tiny"}
PLAIN = PairsConfig(occlusion=0, loose_mask=0, blur_px=0, noise=0, roll_deg=0)


@pytest.fixture(scope="session")
def pool(cache):
    return procedural_pool(PoolConfig(**POOL), cache, Progress(), held_out=False)


def test_a_third_is_held_out_and_never_drawn(cache, pool):
    names = [f"{family}_{i:02d}" for family in FAMILIES for i in range(36)]
    assert 0.28 < np.mean([is_held_out(name) for name in names]) < 0.39
    other = procedural_pool(PoolConfig(**POOL), cache, Progress(), held_out=True)
    assert not set(pool.names) & set(other.names)
    assert len(pool.names) + len(other.names) == 2 * len(FAMILIES)
    assert {view.object_id for view in pool.views} <= set(range(len(pool.names)))


def test_a_pool_is_read_back_and_not_rendered_again(cache, pool, monkeypatch):
    monkeypatch.setattr("toolkit.training.pool._render", None)
    again = procedural_pool(PoolConfig(**POOL), cache, Progress(), held_out=False)
    assert all(np.array_equal(a.rgb, b.rgb) for a, b in zip(pool.views, again.views, strict=True))


def test_correspondences_are_where_the_same_colour_is(pool):
    """Through depth and pose, without augmentation and under near views: what is matched looks alike."""
    source = PairSource(pool, PLAIN.model_copy(update={"max_angle_deg": 180}))
    rng = np.random.default_rng(0)
    pairs = [source.draw(rng) for _ in range(40)]
    assert sum(len(pair.cells) for pair in pairs) > 100
    forth_and_back = []
    for pair in pairs:
        first, second = pair.samples
        start = cell_centers(160)[pair.cells[:, 0]]
        back = _carry(second, first, pair.target_xy)
        forth_and_back.append(np.linalg.norm(back - start, axis=1))
        offsets = pair.target_xy - cell_centers(160)[pair.cells[:, 1]]
        assert (np.abs(offsets) <= 4.0).all()
    gaps = np.concatenate(forth_and_back)
    assert np.nanmedian(gaps) < 0.2


def test_a_view_matches_itself_in_place(pool):
    view = max(pool.views, key=lambda v: int(v.mask.sum()))
    crop = augmented_crop(view, PLAIN, np.random.default_rng(0))
    turned = augmented_crop(view, PLAIN.model_copy(update={"roll_deg": 90}), np.random.default_rng(3))
    same, rolled = relate(crop, crop), relate(crop, turned)
    np.testing.assert_array_equal(same.cells[:, 0], same.cells[:, 1])
    np.testing.assert_allclose(same.target_xy, cell_centers(160)[same.cells[:, 0]], atol=1e-6)
    affine = turned.to_crop[:, :2] @ np.linalg.inv(crop.to_crop[:, :2])
    expected = (cell_centers(160)[rolled.cells[:, 0]] - crop.to_crop[:, 2]) @ affine.T + turned.to_crop[:, 2]
    np.testing.assert_allclose(rolled.target_xy, expected, atol=0.05)


def test_the_confidence_is_kornias():
    torch.manual_seed(0)
    f0, f1 = torch.randn(2, 16, 96), torch.randn(2, 16, 96)
    m0, m1 = torch.rand(2, 16) > 0.3, torch.rand(2, 16) > 0.3
    matching = make_loftr_small().eval().coarse_matching
    data = {"hw0_c": (4, 4), "hw1_c": (4, 4), "stride_c": 8}
    with torch.inference_mode():
        matching(f0, f1, data, m0, m1)
        ours = coarse_log_confidence(f0, f1, m0, m1, matching.temperature).exp()
    both = m0[:, :, None] & m1[:, None]
    torch.testing.assert_close(torch.where(both, ours, 0.0), data["conf_matrix"], atol=1e-5, rtol=1e-4)


def test_the_focal_loss_is_its_definition():
    log_p = torch.log(torch.tensor([[[0.5, 0.1], [0.2, 0.8]]]))
    matched = (torch.tensor([0]), torch.tensor([1]), torch.tensor([1]))
    negative = torch.tensor([[[False, True], [False, False]]])
    expected = -(0.2**2) * np.log(0.8) + 0.5 * -(0.1**2) * np.log(0.9)
    assert float(focal_loss(log_p, matched, negative, 2.0, 0.5)) == pytest.approx(expected, rel=1e-4)


def test_the_fine_loss_leaves_out_what_is_outside_the_window():
    expectation = torch.tensor([[0.1, 0.0, 0.2], [0.5, 0.5, 0.2]])
    target = torch.tensor([[0.1, 0.3], [2.0, 0.0]])
    assert float(fine_loss(expectation, target)) == pytest.approx(0.09, rel=1e-4)


def test_multi_similarity_is_its_definition():
    rng = np.random.default_rng(0)
    vectors = rng.standard_normal((12, 4))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    labels = np.arange(12) % 4
    s = vectors @ vectors.T
    total = 0.0
    for i in range(12):
        positives = [j for j in range(12) if j != i and labels[j] == labels[i]]
        negatives = [j for j in range(12) if labels[j] != labels[i]]
        easiest, hardest = min(s[i, j] for j in positives), max(s[i, j] for j in negatives)
        pull = sum(np.exp(-ALPHA * s[i, j]) for j in positives if s[i, j] - MARGIN < hardest)
        push = sum(np.exp(BETA * s[i, j]) for j in negatives if s[i, j] + MARGIN > easiest)
        total += np.log1p(pull) / ALPHA + np.log1p(push) / BETA
    same = torch.from_numpy((labels[:, None] == labels) & ~np.eye(12, dtype=bool))
    other = torch.from_numpy(labels[:, None] != labels)
    assert float(multi_similarity(torch.from_numpy(s), same, other)) == pytest.approx(total / 12, rel=1e-6)


LOFTR = {
    "loop": {"steps": 6, "batch": 2, "learning_rate": 1e-3, "warmup": 0, "decay": 0, "average": 0.5}
    | {"evaluate_every": 6, "checkpoint_every": 3, "bf16": False},
    "pool": POOL,
    "held_out_frames": 3,
    "pairs": {"crop_size": 96, "max_angle_deg": 180},
    "start": "nothing",
    "evaluation_pairs": 2,
}
MIXVPR = {
    "loop": LOFTR["loop"] | {"batch": 16},
    "pool": POOL,
    "held_out_frames": 3,
    "crops_per_view": 1,
    "views_per_object": 2,
}


@pytest.fixture(params=["loftr", "mixvpr"])
def settings(request, tmp_path, monkeypatch, cache):
    """A training that takes a moment, its YAML file, and random weights for the backbone it starts from."""
    (tmp_path / "settings.yaml").write_text(yaml.safe_dump(LOFTR if request.param == "loftr" else MIXVPR))
    torch.manual_seed(0)
    torch.save(EfficientNetLite0().state_dict(), tmp_path / "backbone.pth")
    monkeypatch.setattr("toolkit.training.run.resolve_weights", lambda name: tmp_path / "backbone.pth")
    return request.param, tmp_path / "settings.yaml"


def run(settings, out, resume=False, device="cpu", **overrides):
    network, file = settings
    chosen = {key.replace("__", "."): value for key, value in overrides.items()}
    options = TrainOptions(out, resume, device=device)
    return train(network, read_training(network, file, chosen), options, Progress())


def test_the_same_seed_gives_the_same_bytes_and_a_resumed_run_too(settings, tmp_path):
    whole = run(settings, tmp_path / "whole")
    again = run(settings, tmp_path / "again")
    assert whole.read_bytes() == again.read_bytes()
    run(settings, tmp_path / "cut", loop__steps=3)
    resumed = run(settings, tmp_path / "cut", resume=True)
    assert resumed.read_bytes() == whole.read_bytes()
    other = run(settings, tmp_path / "other", loop__seed=1)
    assert other.read_bytes() != whole.read_bytes()


def test_processes_that_draw_ahead_change_no_bytes(tmp_path, cache):
    """In a process of its own, as for a user: JAX has threads in this one, and what has threads is not to be forked."""
    file = tmp_path / "settings.yaml"
    file.write_text(yaml.safe_dump(LOFTR))
    own = train("loftr", read_training("loftr", file, {}), TrainOptions(tmp_path / "own"), Progress())
    start = "import sys; sys.argv[0] = 'toolkit'; from toolkit.cli.commands import main; main()"
    out = tmp_path / "drawn"
    command = ["train", "loftr", str(file), "--out", str(out), "--threads", "1", "--workers", "2"]
    done = subprocess.run([sys.executable, "-c", start, *command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "Warning" not in done.stderr
    assert (out / own.name).read_bytes() == own.read_bytes()


def test_a_device_that_is_not_there_is_said_before_any_work(settings, tmp_path):
    with pytest.raises(ToolkitError, match="torch cannot use the device 'nothing'"):
        run(settings, tmp_path / "out", device="nothing")
    assert not (tmp_path / "out").exists()


def test_a_folder_that_cannot_be_written_is_said_before_any_work(settings, tmp_path, monkeypatch):
    monkeypatch.setattr("toolkit.files.os.access", lambda path, mode: False)
    with pytest.raises(ToolkitError, match="cannot be written; use another --out"):
        run(settings, tmp_path / "deep" / "out")
    assert not (tmp_path / "deep").exists()


def test_the_loss_falls_and_all_is_written_down(settings, tmp_path):
    path = run(settings, tmp_path / "out", loop__steps=75, loop__evaluate_every=75)
    with (path.parent / "curves.csv").open() as file:
        rows = list(csv.DictReader(file))
    losses = [float(row["value"]) for row in rows if row["name"] == "loss"]
    assert len(losses) == 3 and losses[-1] < losses[0]
    assert any(row["name"].startswith("held-out/") for row in rows)
    assert (path.parent / "curves.png").stat().st_size > 1000
    card = yaml.safe_load(path.with_suffix(".yaml").read_text())
    assert card["steps"] == 75 and card["size_mb"] < 12 and "held-out" in card["data"]
    assert card["metrics"] and card["machine"] and len(card["sha256"]) == 64
    assert all(t.dtype == torch.float16 for t in load_file(path).values() if t.is_floating_point())


def test_a_folder_of_scans_can_be_trained_on_from_the_shipped_network(tmp_path, cache):
    """Without a step, the shipped network comes out as it went in; a third of the folder is held out."""
    scans = tmp_path / "scans"
    write_set(scans, {"mug": 6})
    settings = read_training("loftr", None, {})
    data = settings.model_dump() | LOFTR | {"start": "tabletop", "pairs": {"crop_size": 96, "max_angle_deg": 180}}
    data["loop"] = data["loop"] | {"steps": 1, "learning_rate": 1e-9, "average": 0.0}
    options = TrainOptions(tmp_path / "out", objects=scans)
    path = train("loftr", LoftrTraining.model_validate(data), options, Progress())
    card = yaml.safe_load(path.with_suffix(".yaml").read_text())
    held_out = sum(is_held_out(f"mug_{i:02d}") for i in range(6))
    assert card["started_from"]["file"] == "loftr_tabletop.safetensors"
    assert f"{6 - held_out} objects of 'scans'" in card["data"] and f"held-out ({held_out} objects" in card["data"]
    shipped = load_file(resolve_weights("loftr-tabletop"))
    for name, value in load_file(path).items():
        if "running" not in name and value.is_floating_point():
            torch.testing.assert_close(value.float(), shipped[name].float(), atol=1e-3, rtol=1e-3)
    write_set(tmp_path / "few", {"mug": 2})
    with pytest.raises(ToolkitError, match="put more objects there"):
        train(
            "loftr",
            LoftrTraining.model_validate(data),
            replace(options, out=tmp_path / "o", objects=tmp_path / "few"),
            Progress(),
        )


def test_mistakes_are_one_sentence(tmp_path, settings):
    network, file = settings
    with pytest.raises(ToolkitError, match="did you mean 'loftr'"):
        read_training("lofter", None, {})
    with pytest.raises(ToolkitError, match=r"setting 'loop\.steps'"):
        read_training(network, file, {"loop.steps": 0})
    with pytest.raises(ToolkitError, match="cannot be read"):
        read_training(network, tmp_path / "no.yaml", {})
    with pytest.raises(ToolkitError, match="no checkpoint"):
        run(settings, tmp_path / "none", resume=True)
    run(settings, tmp_path / "out", loop__steps=1)
    with pytest.raises(ToolkitError, match="already holds a training"):
        run(settings, tmp_path / "out")
    with pytest.raises(ToolkitError, match=r"other settings \(loop\)"):
        run(settings, tmp_path / "out", resume=True, loop__seed=5)


def test_a_group_the_file_leaves_out_keeps_its_defaults_when_one_of_its_settings_is_set(tmp_path):
    (tmp_path / "short.yaml").write_text(yaml.safe_dump({"loop": MIXVPR["loop"]}))
    config = read_training("mixvpr", tmp_path / "short.yaml", {"crops.blur_px": 0})
    default = MixvprTraining.model_fields["crops"].default
    assert config.crops == default.model_copy(update={"blur_px": 0}) != default
    with pytest.raises(ToolkitError, match="there is no 'pol'; did you mean 'pool'"):
        read_training("mixvpr", tmp_path / "short.yaml", {"pol.frames": 3})
    with pytest.raises(ToolkitError, match=r"there is no 'loop\.steps'"):
        read_training("mixvpr", tmp_path / "short.yaml", {"loop.steps.more": 0})


def test_shipped_settings_are_valid():
    for network in ("loftr", "mixvpr"):
        assert read_training(network, None, {}).loop.steps > 0


def test_the_command_line_answers_in_a_sentence():
    result = CliRunner().invoke(app, ["train", "resnet"])
    assert isinstance(result.exception, ToolkitError) and "unknown network" in str(result.exception)


@pytest.mark.parametrize("path", sorted(SHIPPED.glob("*.safetensors")), ids=lambda path: path.stem)
def test_shipped_weights_are_what_their_card_says(path):
    name = path.stem.replace("_", "-")
    card = yaml.safe_load(path.with_suffix(".yaml").read_text())
    assert file_digest(path) == card["sha256"] == CARDS[name].sha256
    assert path.stat().st_size < 12e6
    assert {"data", "steps", "hours", "machine", "metrics", "settings", "started_from"} <= set(card)
    module = {"loftr-tabletop": make_loftr_small, "mixvpr-tabletop": mixer_lite}[name]()
    fill(module, read_tensors(path), path, name)
    assert all(torch.isfinite(value).all() for value in module.state_dict().values())


def test_shipped_weights_need_no_network(monkeypatch, tmp_path):
    monkeypatch.setenv("TOOLKIT_CACHE", str(tmp_path))
    monkeypatch.setattr("toolkit.weights.resolve.fetch", None)
    for name in ("loftr-tabletop", "mixvpr-tabletop"):
        assert resolve_weights(name).parent == SHIPPED


def test_an_exported_loftr_is_what_the_matcher_takes(tmp_path, capture):
    export(make_loftr_small(), tmp_path / "own.safetensors", {})
    matcher = MATCHERS.create("loftr", {"file": str(tmp_path / "own.safetensors"), "threshold": 0})
    frame = capture.current[0]
    crops = [crop_region(frame.rgb, Segment(mask), matcher.crop_size) for mask in frame.true_masks.values()]
    features = matcher.extract(crops)
    (matches,) = matcher.match(features[0], features[:1])
    assert len(matches) > 20
