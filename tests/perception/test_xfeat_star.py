"""XFeat* says where things are: its places, corrected as measured, are those of a picture under known warps."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from toolkit.errors import ToolkitError
from toolkit.perception.matchers.xfeat_star import XFeatStar
from toolkit.types import Crop

SIZE = 320


@pytest.fixture(scope="module")
def matcher():
    made = XFeatStar()
    try:
        made.check_ready()
    except ToolkitError as error:
        pytest.skip(str(error))
    return made


@pytest.fixture(scope="module")
def picture():
    """(2 S, 2 S, 3) uint8 of blobs of many sizes, as surfaces of things have."""
    rng = np.random.default_rng(0)
    octaves = [gaussian_filter(rng.standard_normal((2 * SIZE, 2 * SIZE, 3)), (s, s, 0)) for s in (2, 4, 8, 16)]
    levels = sum(octave / octave.std() for octave in octaves)
    return (128 + 30 * levels).clip(0, 255).astype(np.uint8)


def crop(picture, warp):
    """What a (3, 3) warp of the picture at half its size shows."""
    half = np.array([[0.5, 0, -0.25], [0, 0.5, -0.25], [0, 0, 1]])
    image = cv2.warpAffine(picture, (warp @ half)[:2], (SIZE, SIZE), flags=cv2.INTER_AREA)
    return Crop(image, np.ones((SIZE, SIZE), bool), 1.0, np.zeros(2))


@pytest.mark.parametrize(("scale", "degrees"), [(1.0, 0.0), (1.0, 15.0), (1.0, -15.0), (1.25, 0.0), (0.8, 8.0)])
def test_matches_lie_where_the_warp_puts_them(matcher, picture, scale, degrees):
    warp = np.vstack([cv2.getRotationMatrix2D((SIZE / 2, SIZE / 2), degrees, scale), [0, 0, 1]])
    query, reference = matcher.extract([crop(picture, warp), crop(picture, np.eye(3))])
    matches = matcher.match(query, [reference])[0]
    off = matches.query_xy - (matches.reference_xy @ warp[:2, :2].T + warp[:2, 2])
    right = np.linalg.norm(off, axis=1) < 8
    assert len(matches) > 100
    assert right.mean() > 0.8
    # Not a place beside: without the measured correction, a pixel.
    assert np.abs(np.median(off[right], axis=0)).max() < 0.25


def test_nothing_off_the_object_is_matched(matcher, picture):
    whole = crop(picture, np.eye(3))
    mask = np.hypot(*(np.indices((SIZE, SIZE)) - SIZE / 2)) < 90
    image = np.where(mask[..., None], whole.image, 0).astype(np.uint8)
    cut = matcher.extract([Crop(image, mask, 1.0, np.zeros(2))])[0]
    matches = matcher.match(cut, [cut])[0]
    assert len(matches) > 50
    for xy in (matches.query_xy, matches.reference_xy):
        x, y = np.rint(xy).astype(int).T
        assert mask[y, x].all()
