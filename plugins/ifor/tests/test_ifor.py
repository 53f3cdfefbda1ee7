"""The kit's checks, and flow between pictures whose true motion is known."""

import cv2
import numpy as np
import pytest
from toolkit_ifor import Ifor, IforConfig

from toolkit.conformance import Conforms
from toolkit.types import Crop


class TestIfor(Conforms):
    plugin = Ifor


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
    crops = [Crop(np.ascontiguousarray(i), m, 1.0, np.zeros(2)) for i, m in ((image, mask), (turned, turned_mask))]
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
