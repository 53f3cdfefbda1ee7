"""A look finds how an object lies, leaves as expected what it cannot see, and says so where it sees too little."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from made_plans import HOME, LIMITS, plan
from scipy.spatial.transform import Rotation

from toolkit.geometry import invert, look_at, make_transform, rotation_angle, transform_points
from toolkit.rearrangement.drivers import DriverError
from toolkit.rearrangement.executors.drivers.recorded import Recorded
from toolkit.rearrangement.executors.handling.align import Aligned, align
from toolkit.rearrangement.executors.handling.looking import Look
from toolkit.rearrangement.executors.handling.mover import Eye, Mover
from toolkit.rearrangement.moves import PickPlace
from toolkit.sim.client import Client
from toolkit.sim.robot import Robot
from toolkit.sim.robots import ROBOTS
from toolkit.types import Camera, Failure, Frame

EYE = np.array([0.12, -0.15, 0.2])
HALF = np.array([0.05, 0.035, 0.025])
DIRECTIONS = arrays(np.float64, 3, elements=st.floats(-1, 1, width=32)).filter(lambda v: np.linalg.norm(v) > 0.1)


def box(step=0.002):
    """(N, 3) points and (N, 3) normals all over a box."""
    axes = [np.arange(-half, half + step / 2, step) for half in HALF]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    sides = np.abs(np.abs(grid) - HALF) < 1e-9
    points = grid[sides.any(axis=1)]
    normals = (sides * np.sign(grid))[sides.any(axis=1)]
    return points, normals


def ball(count=6000, radius=0.04):
    """(N, 3) points and (N, 3) normals of a sphere."""
    n = np.arange(count) + 0.5
    height, angle = 1 - 2 * n / count, np.pi * (1 + 5**0.5) * n
    r = np.sqrt(1 - height**2)
    normals = np.stack([r * np.cos(angle), r * np.sin(angle), height], axis=1)
    return radius * normals, normals


def can(radius=0.033, height=0.11):
    """(N, 3) points and (N, 3) normals of a cylinder's side and top."""
    angle, z = np.meshgrid(np.arange(0, 2 * np.pi, 0.05), np.arange(-height / 2, height / 2, 0.002))
    side = np.stack([np.cos(angle.ravel()), np.sin(angle.ravel()), 0 * z.ravel()], axis=1)
    x, y = np.reshape(np.meshgrid(*[np.arange(-radius, radius, 0.002)] * 2), (2, -1))
    top = np.stack([x, y, np.full_like(x, height / 2)], axis=1)[np.hypot(x, y) < radius]
    points = np.concatenate([side * radius + z.reshape(-1, 1) * [0, 0, 1], top])
    return points, np.concatenate([side, np.tile([0.0, 0.0, 1.0], (len(top), 1))])


def shown(points, normals, T, noise=0.001):
    """(M, 3) what an eye sees of a convex thing that has moved by T."""
    at, normals = transform_points(T, points), normals @ T[:3, :3].T
    at = at[((EYE - at) * normals).sum(axis=1) > 0]
    rays = at - EYE
    away = np.linalg.norm(rays, axis=1, keepdims=True)
    return at + rays / away * np.random.default_rng(0).normal(0, noise, (len(at), 1))


def motion(axis, angle_deg, way, length):
    R = Rotation.from_rotvec(np.radians(angle_deg) * axis / np.linalg.norm(axis)).as_matrix()
    return make_transform(R, length * way / np.linalg.norm(way))


def off_by(found, T):
    """Shift of the middle, metres, and turn, degrees."""
    return np.linalg.norm(found[:3, 3] - T[:3, 3]), np.degrees(rotation_angle(found[:3, :3] @ T[:3, :3].T))


@settings(max_examples=40, deadline=None)
@given(DIRECTIONS, st.floats(0, 15), DIRECTIONS, st.floats(0, 0.02))
def test_a_box_seen_from_one_side_is_found(axis, angle_deg, way, length):
    T = motion(axis, angle_deg, way, length)
    found = align(box()[0], shown(*box(), T), EYE)
    assert isinstance(found, Aligned)
    shift, turn = off_by(found.T, T)
    assert shift < 0.001 and turn < 1.0
    assert shift < 3 * found.sigma_m and turn < 3 * found.sigma_deg
    assert found.sigma_m < 0.003 and found.sigma_deg < 4


@settings(max_examples=20, deadline=None)
@given(DIRECTIONS, st.floats(0, 15), DIRECTIONS, st.floats(0, 0.02))
def test_a_ball_is_shifted_and_not_turned(axis, angle_deg, way, length):
    T = motion(axis, angle_deg, way, length)
    found = align(ball()[0], shown(*ball(), T), EYE)
    assert isinstance(found, Aligned)
    assert np.linalg.norm(found.T[:3, 3] - T[:3, 3]) < 0.001
    assert np.degrees(rotation_angle(found.T[:3, :3])) < 1.0
    assert found.sigma_deg > 20  # it says that it does not know


@settings(max_examples=20, deadline=None)
@given(st.floats(-15, 15), st.floats(-12, 12), DIRECTIONS, st.floats(0, 0.01))
def test_a_can_is_tilted_and_not_turned_about_its_axis(spin_deg, tilt_deg, way, length):
    tilt = motion(np.array([1.0, 0, 0]), tilt_deg, way, length)
    T = tilt @ motion(np.array([0, 0, 1.0]), spin_deg, way, 0.0)
    found = align(can()[0], shown(*can(), T), EYE)
    assert isinstance(found, Aligned)
    shift, turn = off_by(found.T, tilt)
    assert shift < 0.002 and turn < 2.0


@pytest.mark.parametrize(
    ("seen", "said"),
    [
        (np.zeros((0, 3)), "too little of the object is seen"),
        (box()[0] + 0.3, "too little of the object is seen"),
        (ball(radius=0.03)[0] * [1.0, 1.0, 0.2] + [0, 0, 0.04], "what is seen does not look like the object"),
    ],
)
def test_what_cannot_be_seen_is_said_in_a_sentence(seen, said):
    failure = align(box()[0], seen, EYE)
    assert isinstance(failure, Failure) and failure.reason.startswith(said)


PANDA = ROBOTS["panda"]
K = np.array([[308.0, 0, 159.5], [0, 308.0, 119.5], [0, 0, 1]])


def ray_cast(T_world_camera, T_world_box, half):
    """(240, 320) float32 depth of a box above a table."""
    v, u = np.mgrid[0:240, 0:320]
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)], axis=-1).reshape(-1, 3)
    rays, eye = rays @ T_world_camera[:3, :3].T, T_world_camera[:3, 3]
    table = np.where(rays[:, 2] < 0, -eye[2] / np.minimum(rays[:, 2], -1e-9), 0.0)
    own, start = rays @ T_world_box[:3, :3], transform_points(invert(T_world_box), eye)
    with np.errstate(divide="ignore"):
        bounds = np.sort((np.array([-half, half])[:, None] - start) / own, axis=0)
    near, far = bounds[0].max(axis=1), bounds[1].min(axis=1)
    depth = np.where((near < far) & (near > 0), near, table)
    return depth.reshape(240, 320).astype(np.float32)


@pytest.fixture(scope="module")
def panda():
    with closing(Client()) as client:
        yield Robot(client, PANDA, make_transform(np.eye(3), np.array([0.0, -0.5, 0.0])))


def held_box(robot, q):
    """(4, 4) a box between the fingers of an arm at (J,) angles, its long side across them."""
    return robot.chain.end(q) @ robot.T_hand_tips(0.07) @ make_transform(np.eye(3), np.array([0, 0, 0.005]))


def look(robot, lies, *, depth=True, others=None):
    """A look, from where the hand is at home, at a box that lies at a (4, 4) pose and was thought to lie as held."""
    q = np.array(PANDA.home)
    camera = look_at(lies[:3, 3] + np.array([0.14, -0.03, 0.1]), lies[:3, 3])
    picture = ray_cast(camera, lies, HALF[[1, 0, 2]])
    frame = Frame(0, np.zeros((240, 320, 3), np.uint8), Camera(K, camera, 320, 240), picture if depth else None)
    points = transform_points(held_box(robot, q), box()[0][:, [1, 0, 2]])
    request = PickPlace(points, np.eye(4), np.zeros((0, 3)) if others is None else others)
    driver = Recorded(q, pictures=[frame])
    driver._state = driver._state.model_copy(update={"opening_m": 0.07})
    return Look(driver, robot, request, None)


@pytest.mark.parametrize("others", [None, np.array([[2.0, 0, 0]])])
def test_one_picture_says_how_an_object_lies_in_the_hand(panda, others):
    q = np.array(PANDA.home)
    off = motion(np.array([1.0, 0.3, 0]), 7.0, np.array([0.2, 1.0, -0.5]), 0.008)
    held = held_box(panda, q)
    looks = look(panda, held @ off, others=others)
    expected = looks.expected()
    np.testing.assert_allclose(expected, invert(panda.chain.end(q)), atol=1e-9)
    in_hand = looks.in_hand(expected)
    moved = invert(held) @ panda.chain.end(q) @ in_hand @ held
    shift, turn = off_by(moved, off)
    assert shift < 0.0015 and turn < 1.0
    assert isinstance(looks.last, Aligned) and looks.last.fits > 0.8
    with pytest.raises(DriverError, match="no further picture"):
        looks.in_hand(expected)


def test_what_is_nearer_to_other_things_is_not_taken_for_the_object(panda):
    held = held_box(panda, np.array(PANDA.home))
    neighbour = transform_points(held, box()[0][:, [1, 0, 2]])
    looks = look(panda, held, others=neighbour)  # the same place: nothing is left of the object
    assert looks.placed(np.eye(4)).reason.startswith("too little of the object is seen")


def test_the_gripper_is_left_out_of_the_picture(panda):
    looks = look(panda, held_box(panda, np.array(PANDA.home)))
    state = looks.driver.state()
    T = panda.chain.end(state.positions) @ panda.T_hand_tips(0.07)
    between, left, right, behind, below = np.array(
        [[0, 0, -0.01], [-0.04, 0, -0.01], [0.045, 0.01, -0.02], [0, 0, -0.08], [0.04, 0, 0.02]]
    )
    kept = looks._without_gripper(transform_points(T, np.array([between, left, right, behind, below])), state)
    np.testing.assert_allclose(kept, transform_points(T, np.array([between, below])))


def test_a_picture_without_depth_is_a_driver_s_mistake(panda):
    looks = look(panda, held_box(panda, np.array(PANDA.home)), depth=False)
    with pytest.raises(DriverError, match="looking: the camera's picture has no depth"):
        looks.in_hand(looks.expected())


class MadeEye(Eye):
    """Sees what it is told."""

    def __init__(self, seen, becomes=None):
        self.seen, self.becomes, self.asked = seen, becomes, []

    def expected(self):
        return np.eye(4)

    def in_hand(self, expected):
        return self.seen

    def adapted(self, way, in_hand):
        self.asked.append(in_hand)
        return self.becomes or way

    def placed(self, expected):
        return expected


def carried(eye):
    phases = []
    robot = Recorded(HOME)
    follow = robot.follow
    robot.follow = lambda request: (phases.append(request.phase), follow(request))
    return Mover(robot, LIMITS, 0.08).carry_out(plan().moves[0].way, eye), phases


def test_what_is_not_seen_is_put_down_as_planned():
    eye = MadeEye(Failure("executor", "too little of the object is seen to say how it lies"))
    failure, phases = carried(eye)
    assert failure is None and eye.asked == [] and phases[-1] == "retreating" and "putting back" not in phases


def test_what_is_seen_decides_how_an_object_is_put_down():
    moved = motion(np.array([0, 0, 1.0]), 6.0, np.array([1.0, 0, 0]), 0.01)
    eye = MadeEye(moved)
    failure, phases = carried(eye)
    assert failure is None and "carrying" in phases
    np.testing.assert_array_equal(eye.asked, [moved])
    failure, phases = carried(MadeEye(moved, Failure("executor", "it would touch something")))
    assert failure.reason == "it would touch something" and "putting back" in phases and "carrying" not in phases


@pytest.mark.parametrize(("angle_deg", "length", "said"), [(0.0, 0.03, "slipped in"), (12.0, 0.0, "turned in")])
def test_what_is_about_to_be_lost_is_put_back(angle_deg, length, said):
    eye = MadeEye(motion(np.array([0, 1.0, 0]), angle_deg, np.array([0, 0, 1.0]), length))
    failure, phases = carried(eye)
    assert failure.reason == f"the object {said} the gripper while it was lifted"
    assert "putting back" in phases and "carrying" not in phases and eye.asked == []
