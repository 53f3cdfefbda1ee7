"""grounded_sam on small networks of the real classes with random weights; nothing is downloaded."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from toolkit.cli.commands import app
from toolkit.errors import ToolkitError
from toolkit.perception.segmenters.grounded_sam import disjoint
from toolkit.stages import SEGMENTERS
from toolkit.weights import resolve, sources
from toolkit.weights.cards import CARDS


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> dict[str, str]:
    """A Grounding DINO and a SAM of few layers, as transformers saves them; ids of special tokens are BERT's."""
    transformers = pytest.importorskip("transformers")
    from transformers.models.grounding_dino.image_processing_pil_grounding_dino import GroundingDinoImageProcessorPil
    from transformers.models.sam.image_processing_pil_sam import SamImageProcessorPil

    torch.manual_seed(0)
    root = tmp_path_factory.mktemp("transformers")
    words = [f"[unused{i}]" for i in range(1040)]
    for index, word in {0: "[PAD]", 100: "[UNK]", 101: "[CLS]", 102: "[SEP]", 103: "[MASK]", 1012: "."}.items():
        words[index] = word
    words[1029:1031] = "?", "objects"
    (root / "vocab.txt").write_text("\n".join(words) + "\n")
    tokenizer = transformers.BertTokenizer(str(root / "vocab.txt"))
    detector = transformers.GroundingDinoForObjectDetection(
        transformers.GroundingDinoConfig(
            backbone_config=transformers.SwinConfig(
                image_size=64,
                embed_dim=8,
                depths=[1, 1, 1, 1],
                num_heads=[1, 1, 1, 1],
                window_size=4,
                out_indices=[2, 3, 4],
            ),
            text_config=transformers.BertConfig(
                vocab_size=1040,
                hidden_size=16,
                num_hidden_layers=1,
                num_attention_heads=2,
                intermediate_size=16,
            ),
            d_model=32,
            num_queries=6,
            encoder_layers=1,
            decoder_layers=2,
            encoder_attention_heads=2,
            decoder_attention_heads=2,
            encoder_ffn_dim=16,
            decoder_ffn_dim=16,
        )
    )
    detector.save_pretrained(root / "detector")
    tokenizer.save_pretrained(root / "detector")
    reader = GroundingDinoImageProcessorPil(size={"shortest_edge": 96, "longest_edge": 128})
    save_as_on_the_hub(reader, root / "detector", "GroundingDino")
    sam = transformers.SamModel(
        transformers.SamConfig(
            vision_config={
                "hidden_size": 16,
                "output_channels": 16,
                "num_hidden_layers": 1,
                "num_attention_heads": 2,
                "image_size": 64,
                "patch_size": 8,
                "global_attn_indexes": [0],
                "num_pos_feats": 8,
                "initializer_range": 0.5,
            },
            prompt_encoder_config={"hidden_size": 16, "image_size": 64, "patch_size": 8, "mask_input_channels": 4},
            mask_decoder_config={
                "hidden_size": 16,
                "mlp_dim": 16,
                "num_hidden_layers": 1,
                "num_attention_heads": 2,
                "iou_head_hidden_dim": 16,
            },
        )
    )
    sam.save_pretrained(root / "sam")
    pad = {"height": 64, "width": 64}
    save_as_on_the_hub(SamImageProcessorPil(size={"longest_edge": 64}, pad_size=pad), root / "sam", "Sam")
    return {name: str(root / name) for name in ("detector", "sam")}


def save_as_on_the_hub(reader, folder: Path, name: str) -> None:
    """The image processor as the published folders have it: one file of its own, written before backends had names."""
    reader.save_pretrained(folder)
    path = folder / "preprocessor_config.json"
    names = {"image_processor_type": f"{name}ImageProcessor", "processor_class": f"{name}Processor"}
    path.write_text(json.dumps(json.loads(path.read_text()) | names))


def test_the_cards_name_all_files_that_are_needed(folders, capture, tmp_path):
    for role, card in (("detector", "grounding-dino-tiny"), ("sam", "sam-vit-base")):
        (tmp_path / role).mkdir()
        for file in (Path(CARDS[card].file).name, *CARDS[card].companions):
            shutil.copy(Path(folders[role]) / file, tmp_path / role)
    fewest = {role: str(tmp_path / role) for role in folders}
    a, b = (open_all(f).segment(capture.goal, []) for f in (folders, fewest))
    assert [s.mask.tobytes() for s in a] == [s.mask.tobytes() for s in b]


def open_all(folders: dict[str, str], **settings):
    """A segmenter that takes every box the random detector gives."""
    return SEGMENTERS.create("grounded_sam", {**folders, "box_threshold": 0, "text_threshold": 0, **settings})


def test_masks_are_disjoint_sorted_and_repeat(folders, capture):
    segments = open_all(folders).segment(capture.goal, capture.current)
    assert segments
    assert sum(s.mask.astype(int) for s in segments).max() == 1
    assert all(s.mask.shape == capture.goal.rgb.shape[:2] and 0 <= s.score <= 1 for s in segments)
    firsts = [int(s.mask.argmax()) for s in segments]
    assert firsts == sorted(firsts)
    again = open_all(folders).segment(capture.goal, [])
    assert [s.mask.tobytes() for s in segments] == [s.mask.tobytes() for s in again]


def test_thresholds_decide_which_boxes_count(folders, capture):
    assert open_all(folders, box_threshold=1).segment(capture.goal, []) == []
    assert open_all(folders, text_threshold=1).segment(capture.goal, []) == []


def test_the_better_mask_keeps_the_pixels_and_repetitions_are_dropped():
    masks = np.zeros((4, 20, 30), bool)
    masks[0, 5:15, 2:12] = True
    masks[1, 4:14, 3:12] = True  # the same object, with a lower score
    masks[2, 0:10, 10:25] = True  # another one, which overlaps a little
    masks[3, 18, 29] = True  # too small
    segments = disjoint(masks, np.array([0.9, 0.8, 0.5, 0.95]), min_pixels=5)
    assert [s.score for s in segments] == [0.5, 0.9]
    np.testing.assert_array_equal(segments[1].mask, masks[0])
    np.testing.assert_array_equal(segments[0].mask, masks[2] & ~masks[0])


def test_every_file_that_makes_the_networks_is_in_the_digests(folders):
    digests = open_all(folders).digests()
    assert {"detector/model.safetensors", "detector/config.json", "sam/model.safetensors"} <= set(digests)


def test_a_folder_that_is_absent_foreign_or_damaged_is_one_sentence(folders, tmp_path):
    shutil.copytree(folders["detector"], tmp_path / "torn")
    (tmp_path / "torn" / "model.safetensors").write_bytes(b"torn")
    shutil.copytree(folders["detector"], tmp_path / "pickled")
    (tmp_path / "pickled" / "model.safetensors").unlink()
    torch.save({}, tmp_path / "pickled" / "pytorch_model.bin")
    shutil.copytree(folders["detector"], tmp_path / "deeper")
    config = json.loads((tmp_path / "deeper" / "config.json").read_text())
    (tmp_path / "deeper" / "config.json").write_text(json.dumps(config | {"encoder_layers": 2}))
    (tmp_path / "empty").mkdir()
    for folder, reason in {
        tmp_path / "absent": "does not exist",
        tmp_path / "empty": "holds no config.json",
        Path(folders["sam"]): "is not a GroundingDinoForObjectDetection: its config.json says 'sam'",
        tmp_path / "torn": "cannot be loaded as GroundingDinoForObjectDetection",
        tmp_path / "pickled": "cannot be loaded as GroundingDinoForObjectDetection",
        tmp_path / "deeper": "they lack 'model.encoder.layers.1",
    }.items():
        with pytest.raises(ToolkitError, match=reason) as error:
            open_all(folders, detector=str(folder)).check_ready()
        assert "\n" not in str(error.value)


def test_what_cannot_be_fetched_is_said_before_any_work(monkeypatch, tmp_path):
    pytest.importorskip("transformers")

    def refuse(source, target, sha256=None, size_mb=None):
        raise OSError(f"{source}: no network")

    monkeypatch.delenv("TOOLKIT_WEIGHTS", raising=False)
    monkeypatch.setenv("TOOLKIT_CACHE", str(tmp_path))
    monkeypatch.setattr(resolve, "fetch", refuse)
    with pytest.raises(ToolkitError, match="weights 'grounding-dino-tiny' cannot be fetched here"):
        SEGMENTERS.get("grounded_sam")().check_ready()


def test_companions_are_fetched_beside_the_checkpoint(monkeypatch, tmp_path):
    fetched = []

    def deliver(source, target, sha256=None, size_mb=None):
        fetched.append(source)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text("{}")

    monkeypatch.delenv("TOOLKIT_WEIGHTS", raising=False)
    monkeypatch.setenv("TOOLKIT_CACHE", str(tmp_path))
    monkeypatch.setattr(resolve, "fetch", deliver)
    folder = resolve.resolve_folder("sam-vit-base")
    names = ["config.json", "model.safetensors", "preprocessor_config.json"]
    assert sorted(path.name for path in folder.iterdir()) == names
    assert sorted(fetched) == [f"hf://facebook/sam-vit-base/{name}" for name in names]
    (folder / "config.json").unlink()
    monkeypatch.setattr(resolve, "fetch", sources.fetch)
    monkeypatch.setattr(sources, "download", lambda *_: (_ for _ in ()).throw(OSError("no network")))
    with pytest.raises(ToolkitError, match=r"config\.json of the weights 'sam-vit-base' cannot be fetched here"):
        resolve.resolve_folder("sam-vit-base")


def test_without_the_extra_everything_else_works(monkeypatch):
    monkeypatch.setitem(sys.modules, "transformers", None)
    with pytest.raises(ToolkitError, match=r"pip install 'rearrange-toolkit\[grounded-sam\]'"):
        SEGMENTERS.get("grounded_sam")().check_ready()
    for command in ("list", "doctor"):
        answer = CliRunner().invoke(app, [command])
        assert answer.exit_code == 0 and "broken" not in answer.stdout
