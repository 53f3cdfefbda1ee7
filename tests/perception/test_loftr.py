"""LoFTR in two halves gives what kornia's whole forward gives; masked cells take no part in the small one."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from kornia.feature import LoFTR
from kornia.feature.loftr.loftr import default_cfg

from toolkit.models.loftr import encode, match_encoded
from toolkit.models.loftr_small import make_loftr_small, masked_tokens, scatter_tokens, standardize

SIZE = 96


@pytest.fixture(scope="module")
def images():
    """(4, 96, 96) grey levels: one texture, shifted, so that even random weights find mutual matches."""
    rng = np.random.default_rng(0)
    texture = rng.uniform(0, 255, (SIZE + 24, SIZE + 24)).astype(np.float32)
    return torch.from_numpy(np.stack([texture[8 * i : 8 * i + SIZE, :SIZE] for i in range(4)]))


@pytest.fixture(scope="module")
def masks():
    y, x = np.indices((SIZE, SIZE))
    return torch.from_numpy(np.stack([np.hypot(x - 48, y - 44) < radius for radius in (40, 30, 44, 36)]))


def official():
    torch.manual_seed(0)
    config = {**default_cfg, "match_coarse": {**default_cfg["match_coarse"], "thr": 0.0}}
    return LoFTR(pretrained=None, config=config).eval()


def small():
    torch.manual_seed(0)
    return make_loftr_small(threshold=0.0).eval()


def assert_same(ours, theirs):
    """The same set of matches, whatever their order."""
    assert len(ours.pair) == len(theirs["batch_indexes"]) > 20
    assert torch.equal(ours.pair, theirs["batch_indexes"])
    torch.testing.assert_close(ours.xy0, theirs["keypoints0"])
    torch.testing.assert_close(ours.xy1, theirs["keypoints1"], atol=1e-3, rtol=0)
    torch.testing.assert_close(ours.confidence, theirs["confidence"], atol=1e-4, rtol=1e-3)


@torch.inference_mode()
def test_official_architecture_equals_kornia(images):
    model = official()
    query, *references = encode(model, images[:, None] / 255)
    ours = match_encoded(model, query, references)
    theirs = model({"image0": images[:1, None].expand(3, -1, -1, -1) / 255, "image1": images[1:, None] / 255})
    assert_same(ours, theirs)


@torch.inference_mode()
def test_leaving_masked_cells_out_equals_masking_them(images, masks):
    model = small()
    standard = standardize(images, masks)
    query, *references = encode(model, standard, masks)
    assert len({len(reference.cells) for reference in references}) > 1
    ours = match_encoded(model, query, references)
    pair = {"image0": standard[:1].expand(3, -1, -1, -1), "image1": standard[1:]}
    theirs = model({**pair, "mask0": masks[:1].expand(3, -1, -1), "mask1": masks[1:]})
    assert_same(ours, theirs)


@torch.inference_mode()
def test_an_empty_mask_breaks_nothing(images, masks):
    model = small()
    none = torch.zeros_like(masks[:1])
    empty, full = (encode(model, standardize(images[:1], m), m)[0] for m in (none, masks[:1]))
    for query, reference in ((empty, full), (full, empty), (empty, empty)):
        assert len(match_encoded(model, query, [reference]).pair) <= 1


def test_tokens_come_back_to_their_cells(masks):
    tokens, valid = masked_tokens(masks)
    numbers = torch.arange(1.0, 145.0).expand(4, -1)
    features = torch.gather(numbers, 1, tokens)[..., None]
    grid = scatter_tokens(features, tokens, valid, 144)[:, :144, 0]
    on = masks[:, ::8, ::8].flatten(1)
    assert torch.equal(grid, torch.where(on, numbers, 0.0))


def test_standardize_ignores_exposure_and_what_is_outside(images, masks):
    once = standardize(images, masks)
    inside = once[:, 0][masks]
    other = standardize(torch.where(masks, 0.5 * images + 20, 255.0), masks)
    torch.testing.assert_close(once, other, atol=1e-4, rtol=1e-4)
    assert abs(float(inside.mean())) < 0.05
    assert torch.equal(once[:, 0][~masks], torch.zeros(int((~masks).sum())))
