"""One contract for every PnP solver, and what is particular to `jax_ransac`."""

from __future__ import annotations

import runpy
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from toolkit.errors import ToolkitError
from toolkit.geometry import invert, look_at, project, rotation_z, transform_points
from toolkit.stages import PNP
from toolkit.types import Camera, Correspondences, Failure, PnPSolution

BENCHMARK = runpy.run_path(str(Path(__file__).parents[2] / "experiments" / "benchmarks" / "pnp.py"))
K, CAMERA, make_problem, pose_error = (BENCHMARK[name] for name in ("K", "CAMERA", "make_problem", "pose_error"))
SETTINGS = {"reprojection_px": 3.0}
PRIORS = ("planar", "none")
CENTER = np.array([0.2, 0.1, 0.06])


def create(name, **settings):
    """A solver that makes no assumption about the motion."""
    free = {"prior": "none"} if name == "jax_joint" else {}
    return PNP.create(name, {**SETTINGS, **free, **settings})


SOLVERS = {name: create(name) for name in PNP.names()}


@pytest.fixture(params=PNP.names())
def solver(request):
    return SOLVERS[request.param]


def solve(solver, problem, seed=0):
    answer = solver.solve(problem.correspondences, seed)
    assert isinstance(answer, PnPSolution), answer
    return answer


def correspondences(points, pixels):
    return Correspondences(points, pixels, np.ones(len(points)), CAMERA)


def failure(solver, points, pixels):
    answer = solver.solve(correspondences(points, pixels), 0)
    assert isinstance(answer, Failure), answer
    assert answer.stage == "pnp"
    return answer.reason


@pytest.mark.parametrize("planar", [False, True])
@pytest.mark.parametrize("n", [8, 12, 40, 200])
def test_exact_data_gives_the_exact_pose(solver, n, planar):
    for seed in range(5):
        problem = make_problem(np.random.default_rng(seed), n, noise_px=0.0, planar=planar)
        answer = solve(solver, problem)
        degrees, millimetres = pose_error(answer.T_camera_world, problem.T, problem.centre)
        assert degrees < 1e-4
        assert millimetres < 1e-3
        assert answer.inliers.all()


@pytest.mark.parametrize("outliers", [0.0, 0.3, 0.5, 0.7])
def test_noise_and_outliers(solver, outliers):
    errors = []
    for seed in range(10):
        problem = make_problem(np.random.default_rng(seed), 100, outliers)
        answer = solve(solver, problem, seed)
        assert abs(answer.inliers.mean() - (1 - outliers)) < 0.1
        errors.append(pose_error(answer.T_camera_world, problem.T, problem.centre))
    degrees, millimetres = np.median(errors, axis=0)
    assert degrees < 0.8
    assert millimetres < 2.5


def test_planar_points_with_outliers(solver):
    errors = []
    for seed in range(10):
        problem = make_problem(np.random.default_rng(seed), 80, outliers=0.5, planar=True)
        errors.append(pose_error(solve(solver, problem).T_camera_world, problem.T, problem.centre)[0])
    assert np.median(errors) < 1.0


def test_the_least_error_is_reached(solver):
    """The poses of all solvers are the same minimum, not only equally far from the truth."""
    if solver.name == "jax_joint":
        pytest.skip("a soft weight has another minimum than least squares on the inliers")
    for seed in range(10):
        problem = make_problem(np.random.default_rng(seed), 90, outliers=0.4)
        ours, reference = solve(solver, problem), solve(SOLVERS["poselib"], problem)
        if np.array_equal(ours.inliers, reference.inliers):
            assert pose_error(ours.T_camera_world, reference.T_camera_world, problem.centre)[0] < 1e-3


@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(12, 120),
    focal=st.tuples(st.floats(300, 1500), st.floats(300, 1500)),
    centre=st.tuples(st.floats(100, 900), st.floats(100, 600)),
)
def test_any_pose_and_camera(solver, seed, n, focal, centre):
    K = np.array([[focal[0], 0.0, centre[0]], [0.0, focal[1], centre[1]], [0.0, 0.0, 1.0]])
    problem = make_problem(np.random.default_rng(seed), n, noise_px=0.0, camera=Camera(K, np.eye(4), 1000, 700))
    answer = solve(solver, problem, seed)
    degrees, millimetres = pose_error(answer.T_camera_world, problem.T, problem.centre)
    assert degrees < 1e-4
    assert millimetres < 1e-3


def test_the_same_seed_gives_the_same_bytes(solver):
    problems = [make_problem(np.random.default_rng(seed), 100, outliers=0.7) for seed in range(5)]
    first = [solve(solver, problem, seed=2**40 + 7) for problem in problems]
    # A fresh instance, in another order: nothing is carried from one solve to the next.
    again = [solve(create(solver.name), problem, seed=2**40 + 7) for problem in reversed(problems)][::-1]
    for a, b in zip(first, again, strict=True):
        assert a.T_camera_world.tobytes() == b.T_camera_world.tobytes()
        assert a.inliers.tobytes() == b.inliers.tobytes()


def test_arrays_are_left_alone(solver):
    problem = make_problem(np.random.default_rng(0), 30).correspondences
    before = [array.tobytes() for array in (problem.points, problem.pixels, problem.K)]
    solver.solve(problem, 0)
    assert before == [array.tobytes() for array in (problem.points, problem.pixels, problem.K)]


def test_too_few_correspondences(solver):
    for n in (0, 1, 3, 7):
        problem = make_problem(np.random.default_rng(0), 10).correspondences
        assert f"too few correspondences ({n} of" in failure(solver, problem.points[:n], problem.pixels[:n])


def test_coincident_and_collinear_points(solver):
    rng = np.random.default_rng(0)
    pixels = rng.uniform(0, 400, (20, 2))
    assert "collinear" in failure(solver, np.ones((20, 3)), pixels)
    assert "collinear" in failure(solver, np.outer(np.linspace(0, 1, 20), [1.0, 2.0, 3.0]) + 5, pixels)


def test_unrelated_points(solver):
    rng = np.random.default_rng(3)
    failure(solver, rng.uniform(-0.05, 0.05, (20, 3)), rng.uniform(0, 400, (20, 2)))


def test_one_spot_in_the_image(solver):
    rng = np.random.default_rng(0)
    failure(solver, rng.uniform(-0.05, 0.05, (30, 3)), np.array([300.0, 200.0]) + rng.uniform(-0.5, 0.5, (30, 2)))


def test_object_behind_the_camera(solver):
    """The pixels of an inverted pinhole: only a pose with negative depths explains them."""
    rng = np.random.default_rng(0)
    problem = make_problem(rng, 60, noise_px=0.0)
    mirrored = 2 * K[:2, 2] - problem.correspondences.pixels
    answer = solver.solve(correspondences(problem.correspondences.points, mirrored), 0)
    # Turning the object by 180 deg about the optical axis is a fair answer; one behind the camera is not.
    if isinstance(answer, PnPSolution):
        assert (answer.T_camera_world[:3] @ np.append(problem.centre, 1.0))[2] > 0


def test_a_pose_behind_the_camera_is_refused(solver, monkeypatch):
    problem = make_problem(np.random.default_rng(0), 20)
    behind = np.diag([1.0, 1.0, -1.0, 1.0]) @ np.diag([1.0, -1.0, 1.0, 1.0]) @ problem.T
    monkeypatch.setattr(solver, "find_pose", lambda *_: behind)
    answer = solver.solve(problem.correspondences, 0)
    assert answer == Failure("pnp", "the object is behind the camera")
    monkeypatch.setattr(solver, "find_pose", lambda *_: np.full((4, 4), np.nan))
    assert isinstance(solver.solve(problem.correspondences, 0), Failure)


def test_settings_are_shared_and_checked(solver):
    assert len(solver.solve(make_problem(np.random.default_rng(0), 10).correspondences, 0).inliers) == 10
    strict = PNP.create(solver.name, {"min_inliers": 11})
    assert isinstance(strict.solve(make_problem(np.random.default_rng(0), 10).correspondences, 0), Failure)
    with pytest.raises(ToolkitError, match="reprojection_px"):
        PNP.create(solver.name, {"reprojection_px": 0})
    with pytest.raises(ToolkitError, match="did you mean 'iterations'"):
        PNP.create(solver.name, {"iteration": 10})


@pytest.mark.parametrize("outliers", [0.0, 0.4, 0.7])
def test_jax_ransac_agrees_with_poselib(outliers):
    differences, errors = [], []
    for seed in range(20):
        problem = make_problem(np.random.default_rng(100 + seed), 150, outliers)
        ours, theirs = (solve(SOLVERS[name], problem, seed).T_camera_world for name in ("jax_ransac", "poselib"))
        differences.append(pose_error(ours, theirs, problem.centre)[0])
        errors.append(pose_error(theirs, problem.T, problem.centre)[0])
    assert np.median(differences) < 0.1 * np.median(errors)


def test_jax_ransac_uses_all_of_many_correspondences():
    """More correspondences than the search looks at: the polish still reaches PoseLib's minimum."""
    problem = make_problem(np.random.default_rng(0), 1500, outliers=0.6)
    ours, theirs = solve(SOLVERS["jax_ransac"], problem), solve(SOLVERS["poselib"], problem)
    assert abs(int(ours.inliers.sum()) - int(theirs.inliers.sum())) <= 3
    assert pose_error(ours.T_camera_world, theirs.T_camera_world, problem.centre)[0] < 0.02


def test_jax_ransac_compiles_once_per_bucket():
    compilations = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compilations.append(event) if "backend_compile" in event else None
    )
    fresh = PNP.create("jax_ransac", {"iterations": 700})  # another number of rounds: another shape
    fresh.solve(make_problem(np.random.default_rng(0), 20).correspondences, 0)
    assert compilations
    compilations.clear()
    for n in (8, 20, 77, 128):
        fresh.solve(make_problem(np.random.default_rng(n), n, outliers=0.2).correspondences, n)
    assert not compilations


def test_jax_ransac_leaves_the_precision_of_others_alone():
    SOLVERS["jax_ransac"].solve(make_problem(np.random.default_rng(0), 20).correspondences, 0)
    assert jnp.ones(3).dtype == jnp.float32


def test_p3p_finds_the_true_pose():
    from toolkit.perception.pnp.solving.p3p import p3p

    problems = [make_problem(np.random.default_rng(seed), 3, noise_px=0.0) for seed in range(500)]
    points = np.stack([p.correspondences.points - p.centre for p in problems]) / 0.05
    pixels = np.stack([p.correspondences.pixels for p in problems])
    rays = np.concatenate([(pixels - K[:2, 2]) / K[0, 0], np.ones((500, 3, 1))], axis=2)
    with jax.enable_x64(True):
        rays = rays / np.linalg.norm(rays, axis=2, keepdims=True)
        R, t, real = (np.asarray(value) for value in jax.jit(jax.vmap(p3p))(points, rays))
    truth = np.stack([p.T[:3, :3] for p in problems])
    error = np.where(real, np.abs(R - truth[:, None]).max(axis=(2, 3)), np.inf).min(axis=1)
    assert (error < 1e-6).mean() > 0.99
    # Every solution that is called real explains its rays, in front of the camera.
    seen = np.einsum("nsij,npj->nspi", R, points) + t[:, :, None]
    cosine = np.einsum("nspi,npi->nsp", seen, rays) / np.linalg.norm(seen, axis=3)
    assert cosine[real].min() > 1 - 1e-9


def test_benchmark_prints_its_tables(capsys):
    BENCHMARK["main"](["--problems", "8", "--repeats", "1"])
    printed = capsys.readouterr().out
    assert all(name in printed for name in PNP.names())
    assert "same verdict" in printed


def on_table(seed, n=40, outliers=0.0, noise_px=0.3):
    """A box of points that turned about the vertical and slid on the table, and the true motion."""
    rng = np.random.default_rng(seed)
    camera = Camera(K, look_at(np.array([0.1, -0.8, 0.7]), np.zeros(3)), 640, 480)
    points = rng.uniform(-0.05, 0.05, (n, 3)) + CENTER
    motion = rotation_z(rng.uniform(-np.pi, np.pi))
    motion[:2, 3] = rng.uniform(-0.1, 0.1, 2) - (motion[:3, :3] @ CENTER)[:2]
    pixels, _ = project(K, invert(camera.T_world_camera), transform_points(motion, points))
    pixels += noise_px * rng.standard_normal((n, 2))
    wrong = rng.permutation(n)[: round(outliers * n)]
    pixels[wrong] = rng.uniform(pixels.min(axis=0), pixels.max(axis=0), (len(wrong), 2))
    return Correspondences(points, pixels, np.ones(n), camera), motion


def planar_error(problem, solution, motion):
    """Turn in radians and shift of the points' mean in metres, (6,), as the covariance counts them."""
    found = problem.camera.T_world_camera @ solution.T_camera_world
    center = problem.points.mean(axis=0)
    turn = Rotation.from_matrix(found[:3, :3] @ motion[:3, :3].T).as_rotvec()
    return np.concatenate([turn, transform_points(found, center) - transform_points(motion, center)])


@pytest.mark.parametrize("outliers", [0.0, 0.5, 0.8])
def test_on_the_table_two_points_are_enough(outliers):
    joint = create("jax_joint", prior="planar")
    for seed in range(10):
        problem, motion = on_table(seed, n=100, outliers=outliers)
        error = planar_error(problem, joint.solve(problem, seed), motion)
        np.testing.assert_allclose(error[[0, 1, 5]], 0, atol=1e-9)
        assert abs(error[2]) < np.radians(1) and np.linalg.norm(error[3:]) < 0.002


def test_the_prior_makes_a_pose_more_certain():
    problem, _ = on_table(0, n=12)
    planar, free = (create("jax_joint", prior=prior).solve(problem, 0) for prior in PRIORS)
    assert (np.diag(planar.covariance)[[2, 3, 4]] < np.diag(free.covariance)[[2, 3, 4]]).all()
    assert (np.diag(planar.covariance)[[0, 1, 5]] == 0).all() and (np.diag(free.covariance) > 0).all()


@pytest.mark.parametrize("prior", PRIORS)
def test_the_covariance_says_how_far_off_the_pose_is(prior):
    """Squared errors in units of their stated covariance follow chi-square: mean = degrees of freedom."""
    joint = create("jax_joint", prior=prior)
    rows = [2, 3, 4] if prior == "planar" else list(range(6))
    ratios = []
    for seed in range(80):
        problem, motion = on_table(seed)
        solution = joint.solve(problem, seed)
        error = planar_error(problem, solution, motion)[rows]
        ratios.append(error @ np.linalg.solve(solution.covariance[np.ix_(rows, rows)], error))
    assert 0.6 * len(rows) < np.mean(ratios) < 1.6 * len(rows)


def test_certain_matches_outvote_uncertain_ones():
    """Two consistent motions in one problem: the one whose matches score higher wins, though it has fewer."""
    (a, motion), (b, _) = on_table(1, n=30), on_table(2, n=40)
    problem = Correspondences(
        np.concatenate([a.points, b.points]),
        np.concatenate([a.pixels, b.pixels]),
        np.concatenate([np.full(30, 0.9), np.full(40, 0.2)]),
        a.camera,
    )
    error = planar_error(problem, create("jax_joint", prior="planar").solve(problem, 0), motion)
    assert np.linalg.norm(error[3:]) < 0.005
