"""What an arm keeps clear of: seen points, what lies below them, and what it carries."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from toolkit.geometry import make_transform, rotation_z, transform_points
from toolkit.sim.clearance import Clearance
from toolkit.sim.client import Client
from toolkit.sim.cubes import FINE_M, any_inside, around, deepened, standing, underside, with_underside, without
from toolkit.sim.robot import Robot
from toolkit.sim.robots import ROBOTS
from toolkit.types import Cubes

POINTS = arrays(np.float64, st.tuples(st.integers(1, 30), st.just(3)), elements=st.floats(-0.5, 0.5, width=32))
HOME = np.array(ROBOTS["panda"].home)
NOTHING = np.zeros((0, 3))


@given(POINTS, st.sampled_from([0.002, 0.004, 0.01]), st.sampled_from([0.0, 0.001, 0.002, 0.007]))
def test_cubes_hold_their_points_and_their_margin_and_little_more(points, side, margin):
    cubes = around(points, side, margin)
    assert len(np.unique(cubes.cells, axis=0)) == len(cubes.cells)
    for point in points:
        away = np.abs(cubes.centers - point).max(axis=1)
        assert away.min() <= side / 2 + 1e-9
    for center in cubes.centers:
        assert np.abs(points - center).max(axis=1).min() <= margin + side / 2 + 1e-9
    for shift in margin * np.vstack([part * np.vstack([np.eye(3), -np.eye(3)]) for part in (0.3, 0.6, 0.99)]):
        assert any_inside(cubes, points + shift)


@given(POINTS)
def test_what_stands_is_full_down_to_the_table(points):
    points = points + np.array([0, 0, 0.6])
    seen = around(points, 0.01)
    full = standing(seen)
    assert len(np.unique(full.cells, axis=0)) == len(full.cells)
    assert full.cells[:, 2].min() == 0
    for part in (0.01, 0.5, 1.0):
        assert any_inside(full, points[:1] * [1, 1, part])
    tops = {(x, y): z for x, y, z in sorted(seen.cells.tolist())}
    assert all(z <= tops[x, y] for x, y, z in full.cells.tolist())


@given(POINTS, POINTS)
def test_what_is_taken_out_is_gone(points, other):
    left = without(around(points, 0.01), around(other, 0.01))
    assert left is None or not any_inside(left, other)
    assert any_inside(around(other, 0.01), points) or len(left.cells) == len(around(points, 0.01).cells)


@pytest.fixture(scope="module")
def clearance():
    with closing(Client()) as client:
        return Clearance(Robot(client, ROBOTS["panda"], np.eye(4)), margin=0.002)


def below(clearance, depth):
    """(N, 3) a block of 2 cm, whose top lies this far below the hand at home."""
    block = np.stack(np.meshgrid(*[np.linspace(-0.01, 0.01, 11)] * 3), axis=-1).reshape(-1, 3)
    hand = clearance.robot.chain.end(HOME)
    return block + hand[:3, 3] - [0, 0, depth + 0.01]


def test_what_was_seen_is_not_run_into(clearance):
    nothing = np.zeros((0, 3))
    clearance.see(nothing, nothing)
    assert clearance.free(HOME)
    chain = clearance.robot.chain
    (in_the_table, *_) = chain.solve(make_transform(np.eye(3), np.array([0, 0, -0.5])) @ chain.end(HOME), HOME[None])
    assert not clearance.free(in_the_table)
    for points, others in ((below(clearance, 0.05), nothing), (nothing, below(clearance, 0.05))):
        clearance.see(points, others)
        assert not clearance.free(HOME)
    clearance.see(below(clearance, 0.2), below(clearance, 0.2))
    assert clearance.free(HOME)


def test_space_below_what_was_seen_is_full(clearance):
    """A lid beside the arm, above the fingers, leaves no room for them below it; taken as the object, it does."""
    lid = below(clearance, -0.30)
    clearance.see(lid, np.zeros((0, 3)))
    assert clearance.free(HOME)
    clearance.see(np.zeros((0, 3)), lid)
    assert not clearance.free(HOME)


def test_what_is_carried_goes_along_and_hits_what_stands_around(clearance):
    """A block below the fingers, and a post beside it that ends below the fingers too."""
    block, aside = below(clearance, 0.12), make_transform(np.eye(3), np.array([0.03, 0, 0]))
    clearance.see(block, block + np.array([0.04, 0, 0]))
    clearance.carry(clearance.in_hand(HOME))
    assert clearance.free(HOME) and clearance.room(np.eye(4))
    clearance.carry(clearance.in_hand(HOME) @ aside)
    assert not clearance.free(HOME) and not clearance.room(aside)
    clearance.arrange(clearance.robot.model.drive[0])
    assert clearance.free(HOME)


def test_what_was_arranged_before_changes_nothing(clearance):
    """In any order: at rest, approached, carried, put down, near and far."""
    block = below(clearance, 0.12)
    post = np.stack(np.meshgrid([-0.04, 0.04], [0.0], np.linspace(-0.05, 0.05, 40)), axis=-1).reshape(-1, 3)
    others = block.mean(axis=0) + post
    held, beside = clearance.in_hand(HOME), make_transform(np.eye(3), np.array([0, 0.05, 0]))
    opened, shut = clearance.robot.model.drive[0], clearance.robot.drive_for(0.02)
    ways = [
        lambda it: it.arrange(opened),
        lambda it: it.arrange(opened, far=True),
        lambda it: it.approach(),
        lambda it: it.carry(held),
        lambda it: it.carry(held, over_table=True, far=True),
        lambda it: it.carry(held, far=True),
        lambda it: it.put(beside, shut, held=True),
        lambda it: it.put(beside, shut, held=False),
    ]
    rng = np.random.default_rng(0)
    poses = HOME + rng.normal(0, 0.08, (40, len(HOME)))

    def free(it):
        return [it.free(q) for q in poses]

    expected = []
    for way in ways:
        fresh = Clearance(clearance.robot, margin=0.002)
        fresh.see(block, others)
        way(fresh)
        expected.append(free(fresh))
    assert len({tuple(answers) for answers in expected}) > 4
    clearance.see(block, others)
    for number in rng.integers(0, len(ways), 60):
        if number < 2 or clearance.drive == opened:  # the others keep the fingers as they are
            ways[number](clearance)
            assert free(clearance) == expected[number], number


def test_what_is_carried_has_an_underside(clearance):
    """What it was seen to stand on, 1 cm below its lowest point, is part of it; a post 4 cm below is not."""
    block = below(clearance, 0.12)
    for depth, free in ((0.01, False), (0.04, True)):
        x, y, _ = block.mean(axis=0)
        clearance.see(block, np.array([[x + 0.03, y, block[:, 2].min() - depth]]))
        beside = make_transform(np.eye(3), np.array([0.03, 0, 0]))
        clearance.carry(clearance.in_hand(HOME) @ beside)
        assert clearance.free(HOME) == free
        assert clearance.fits(beside) == free


@given(POINTS, st.floats(-np.pi, np.pi))
def test_no_underside_is_where_it_was_seen_to_be_empty(points, turn):
    """However a lid has been turned since, all of it that was seen stays, and nothing else does."""
    points = points * [1, 1, 0] + [0, 0, 0.6]
    below = underside(around(points, FINE_M)).centers
    T = rotation_z(turn)
    hollow = with_underside(transform_points(T, points), transform_points(T, below))
    assert without(around(transform_points(T, points), FINE_M), hollow) is None
    assert without(hollow, around(transform_points(T, points), FINE_M)) is None
    right = below[below[:, 0] > 0]
    half = with_underside(points, right)
    assert not any_inside(half, right)
    assert len(half.cells) >= len(with_underside(points, NOTHING).cells) - np.count_nonzero(below[:, 0] > -2 * FINE_M)


def test_an_underside_ends_at_the_table():
    cubes = Cubes(np.array([[0, 0, 3], [0, 0, 7], [1, 0, 30]]), 0.002)
    found = {tuple(cell) for cell in deepened(cubes, 0.01).cells.tolist()}
    lower = {(0, 0, z) for z in range(3)} | {(1, 0, z) for z in range(25, 30)}
    assert found == {(0, 0, 3), (0, 0, 7), (1, 0, 30)} | lower


def test_room_is_where_nothing_else_was_seen(clearance):
    block = below(clearance, 0.3)
    clearance.see(block, block + np.array([0.03, 0, 0]))
    shifts = {0.0: True, 0.004: True, 0.012: False, 0.03: False, 0.06: True}
    for shift, room in shifts.items():
        T = make_transform(np.eye(3), np.array([shift, 0, 0]))
        assert clearance.room(T) == room, shift


def test_things_that_touch_share_no_space(clearance):
    """A neighbour as near as can be does not keep an object from being lifted."""
    block = below(clearance, 0.11)
    clearance.see(block, block + np.array([0, 0.0225, 0]))
    clearance.carry(clearance.in_hand(HOME))
    assert clearance.free(HOME)
