"""Depth effects on scenes whose answer is known: a wall with a board before it."""

from __future__ import annotations

import numpy as np
import pytest

from toolkit.data import noise, sensors
from toolkit.data.conditions import KINECT, PUBLISHED, REALSENSE
from toolkit.data.sensors import SENSORS, measure_depth

FOCAL = 616.0
NEAR, FAR = 0.8, 1.2
GREY = np.full((240, 320, 3), 128, np.uint8)


def step():
    """A wall, and a board in the middle of the picture."""
    depth = np.full((240, 320), FAR, np.float32)
    depth[60:180, 120:200] = NEAR
    return depth


@pytest.mark.parametrize(("kind", "side"), [("d435", slice(80, 120)), ("kinect", slice(200, 240))])
def test_the_shadow_lies_on_the_second_eye_s_far_side_and_is_as_wide_as_geometry_says(kind, side):
    sensor = SENSORS[kind]
    lost = sensors.stereo_shadow(step(), FOCAL, sensor, np.random.default_rng(0))
    expected = FOCAL * abs(sensor.baseline_m) * (1 / NEAR - 1 / FAR)
    width = lost[80:160, side].sum(axis=1).mean()
    assert expected - 2 <= width <= expected + 1.5 * sensor.window_px + 2
    # The board itself and the wall on the other side are seen by both eyes.
    assert not lost[80:160, 122:198].any()
    assert lost[80:160].sum() - lost[80:160, side].sum() <= 80 * sensor.window_px


def test_no_shadow_without_an_edge():
    slope = np.tile(np.linspace(0.8, 1.2, 320, dtype=np.float32), (240, 1))
    for sensor in SENSORS.values():
        assert not sensors.stereo_shadow(slope, FOCAL, sensor, np.random.default_rng(0)).any()


def test_mixed_pixels_lie_between_the_surfaces_and_only_at_the_edge():
    depth = step()
    mixed = sensors.mixed_edges(depth, SENSORS["d435"], np.random.default_rng(0))
    between = (mixed > NEAR + 0.02) & (mixed < FAR - 0.02)
    assert between.sum() > 200
    assert mixed.max() <= FAR + 1e-4 and mixed[mixed > 0].min() >= NEAR - 1e-4
    y, x = np.nonzero(mixed != depth)
    to_edge = np.minimum.reduce([abs(x - 119.5), abs(x - 199.5), abs(y - 59.5), abs(y - 179.5)])
    assert to_edge.max() < 8


@pytest.mark.parametrize("z", [0.6, 1.0, 2.0])
def test_kinect_steps_grow_with_the_square_of_distance(z):
    stepped = np.unique(sensors.kinect_steps(np.linspace(0.97 * z, 1.03 * z, 20000, dtype=np.float32)))
    assert np.median(np.diff(stepped)) == pytest.approx(0.00285 * z**2, rel=0.05)
    assert sensors.kinect_steps(np.zeros((2, 2), np.float32)).max() == 0


def test_kinect_noise_is_as_published():
    """Nguyen et al., Eq. 3, facing the surface."""
    rng = np.random.default_rng(0)
    for z in (0.5, 1.0, 2.0):
        spread = np.std(sensors.kinect_noise(np.full((300, 300), z, np.float32), FOCAL, rng) - z)
        assert spread == pytest.approx(0.0012 + 0.0019 * (z - 0.4) ** 2, rel=0.05)


def test_holes_lie_on_what_is_black_or_glares():
    picture = GREY.copy()
    picture[:120, 160:] = 250
    lost = np.mean([sensors.holes(step(), picture, np.random.default_rng(i)) for i in range(8)], axis=0)
    assert lost[:120, 160:].mean() > 20 * max(lost[120:].mean(), 1e-4)
    black = GREY.copy()
    black[:120] = 5
    lost = np.mean([sensors.holes(step(), black, np.random.default_rng(i)) for i in range(8)], axis=0)
    assert lost[:120].mean() > 5 * max(lost[120:].mean(), 1e-4)


def test_nothing_is_measured_beyond_the_range_or_at_the_border():
    depth = step()
    depth[:, 300:] = 5.0
    lost = sensors.border(depth, SENSORS["kinect"], np.random.default_rng(0))
    assert lost[:, 300:].all() and lost[:4].all() and not lost[60:180, 60:280].any()


@pytest.mark.parametrize(("kind", "effects"), [("d435", REALSENSE), ("kinect", KINECT), ("d435", ())])
def test_what_is_measured_is_depth_and_the_same_for_the_same_seed(kind, effects):
    depth = step()
    depth[:20] = 0
    measured = [measure_depth(depth, GREY, FOCAL, kind, effects, np.random.default_rng(3)) for _ in range(2)]
    np.testing.assert_array_equal(*measured)
    assert np.isfinite(measured[0]).all() and (measured[0] >= 0).all() and measured[0].dtype == np.float32
    assert not measured[0][:18].any(), "nothing is measured where nothing is"
    if not effects:
        np.testing.assert_array_equal(measured[0], depth)


def test_the_published_effects_are_what_they_were():
    depth, rng, other = step(), np.random.default_rng(1), np.random.default_rng(1)
    expected = noise.dropout(noise.quantize(noise.axial_noise(depth, other)), other)
    np.testing.assert_array_equal(measure_depth(depth, GREY, FOCAL, "d435", PUBLISHED, rng), expected)
