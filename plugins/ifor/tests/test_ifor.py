"""The kit's checks, and flow between pictures whose true motion is known."""

import cv2
import numpy as np
import pytest
import torch
from toolkit_ifor import Ifor, IforConfig
from toolkit_ifor.flows import GMFLOW, dis, gmflow

from toolkit.errors import ToolkitError
from toolkit.plugin_kit.conformance import Conforms
from toolkit.types import Crop
from toolkit.weights.resolve import find_weights

WEIGHTS = find_weights(GMFLOW)
needs_weights = pytest.mark.skipif(
    WEIGHTS is None, reason=f"{GMFLOW.file} is not on this machine; the first run with flow: gmflow fetches it"
)


class TestIfor(Conforms):
    plugin = Ifor


@needs_weights
class TestIforWithGmflow(Conforms):
    plugin = Ifor
    settings = {"flow": "gmflow", "iterations": 1, "crop_size": 96}  # noqa: RUF012


def moved(degrees, x, y, size=160):
    """Two views of a random pattern, the (size, size, 2) flow between them, and where both show it well inside."""
    rng, full = np.random.default_rng(0), 2 * size
    layers = [rng.uniform(-1, 1, (n, n, 3)) / np.sqrt(n) for n in (10, 20, 40, 80)]
    pattern = sum(cv2.resize(layer, (full, full), interpolation=cv2.INTER_CUBIC) for layer in layers)
    pattern = cv2.normalize(pattern, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    A = cv2.getRotationMatrix2D((size, size), degrees, 1.0)
    A[:, 2] += x, y
    part = slice(size // 2, size // 2 + size)
    v, u = np.mgrid[part, part]
    xy = np.stack([u, v], axis=-1)
    there = xy @ A[:, :2].T + A[:, 2]
    inside = ((there > part.start + 8) & (there < part.stop - 8)).all(axis=-1)
    inside[:8], inside[-8:], inside[:, :8], inside[:, -8:] = False, False, False, False
    views = (np.ascontiguousarray(image[part, part]) for image in (pattern, cv2.warpAffine(pattern, A, (full, full))))
    return *views, there - xy, inside


@needs_weights
@pytest.mark.parametrize(("degrees", "x", "y"), [(0, 3, 2), (0, 13, -7), (0, 40, 0), (10, 0, 0)])
def test_gmflow_finds_the_flow(degrees, x, y):
    source, target, truth, inside = moved(degrees, x, y)
    off = np.linalg.norm(gmflow(WEIGHTS, "cpu")(source, target) - truth, axis=-1)[inside]
    assert np.median(off) < 1 and np.quantile(off, 0.9) < 2


def test_dis_finds_a_small_flow():
    source, target, truth, inside = moved(2, 3, 2)
    assert np.median(np.linalg.norm(dis()(source, target) - truth, axis=-1)[inside]) < 0.5


def test_a_foreign_checkpoint_is_one_sentence(tmp_path):
    torch.save({"weight": torch.zeros(3)}, tmp_path / "foreign.pkl")
    for file, message in (("foreign.pkl", "is not a checkpoint of GMFlow"), ("no.pkl", "does not exist")):
        with pytest.raises(ToolkitError, match=message):
            Ifor(IforConfig(flow="gmflow", file=tmp_path / file)).check_ready()


def printed(size=160):
    """A disc with a random pattern."""
    rng = np.random.default_rng(0)
    image = cv2.resize(rng.integers(0, 255, (24, 24, 3), np.uint8), (size, size), interpolation=cv2.INTER_CUBIC)
    y, x = np.mgrid[:size, :size]
    mask = np.hypot(x - size / 2, y - size / 2) < 0.4 * size
    return image * mask[..., None], mask


@pytest.mark.parametrize("degrees", [0, 20, 100, 180, 260])
def test_a_turned_disc_is_matched_where_it_turned_to(degrees):
    image, mask = printed()
    A = np.asarray(cv2.getRotationMatrix2D((80, 80), degrees, 0.9))
    turned = cv2.warpAffine(image, A, (160, 160))
    turned_mask = cv2.warpAffine(mask.astype(np.uint8), A, (160, 160), flags=cv2.INTER_NEAREST) > 0
    pictures = ((image, mask), (turned * turned_mask[..., None], turned_mask))
    crops = [Crop(np.ascontiguousarray(i), m, 1.0, np.zeros(2)) for i, m in pictures]
    ifor = Ifor(IforConfig(starts=4))
    query, reference = ifor.extract(crops)
    (matches,) = ifor.match(query, [reference])
    assert len(matches) > 200
    off = np.linalg.norm(matches.query_xy @ A[:, :2].T + A[:, 2] - matches.reference_xy, axis=1)
    assert np.median(off) < 0.5 and np.quantile(off, 0.9) < 2


def test_another_picture_does_not_match():
    image, mask = printed()
    other = np.random.default_rng(1).integers(0, 255, (24, 24, 3), np.uint8)
    other = cv2.resize(other, (160, 160), interpolation=cv2.INTER_CUBIC) * mask[..., None]
    ifor = Ifor(IforConfig())
    query, reference = ifor.extract([Crop(i, mask, 1.0, np.zeros(2)) for i in (image, other)])
    assert len(ifor.match(query, [reference])[0]) == 0
