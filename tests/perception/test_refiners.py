"""Render and compare: geometry against finite differences, motions against the truth, bad input against crashes."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from usual import usual_stages

from toolkit.data.bop import load_capture
from toolkit.data.dataset import build_dataset
from toolkit.data.tabletop import TabletopConfig
from toolkit.geometry import make_transform, rotation_angle, rotation_z, transform_points
from toolkit.perception.assignment import assign_instances, contenders, instance_similarity, restrict
from toolkit.perception.fusion import FusedModel, Models, Patch, RefineTask, Start, clouds, fuse
from toolkit.perception.jax_geometry import rotation_exp
from toolkit.perception.lighting import estimate_light, relit
from toolkit.perception.pipeline import Pipeline, PipelineSettings
from toolkit.perception.refiners.comparing import align as alignment
from toolkit.perception.refiners.comparing.cloud import Cloud
from toolkit.perception.refiners.comparing.combine import _about, combine
from toolkit.perception.refiners.comparing.compare import Hypothesis
from toolkit.perception.refiners.comparing.goal import LEVELS_PX, view_goal
from toolkit.perception.refiners.comparing.images import Normalizer, opponent
from toolkit.perception.refiners.comparing.likeness import unlikeness
from toolkit.perception.refiners.comparing.rotations import resting_rotations, yaw_rotations
from toolkit.perception.refiners.comparing.verdict import judge
from toolkit.perception.refiners.render_compare import RenderCompare
from toolkit.perception.regions import lift_segment
from toolkit.results.metrics import pose_error
from toolkit.results.scoring import score
from toolkit.stages import REFINERS
from toolkit.types import Abstention, Failure, Refined, Segment


def make_pipeline(refiner, settings=None, **pipeline):
    return Pipeline(usual_stages(refiner=REFINERS.create(refiner, settings)), PipelineSettings(**pipeline))


@pytest.fixture(scope="module")
def database(capture):
    return make_pipeline("none").build_database(capture.current)


@pytest.fixture(scope="module")
def tasks(capture, database):
    """Every object with its true instance, and no start."""
    models = Models(database)
    segments = {i: Segment(mask) for i, mask in sorted(capture.goal.true_masks.items())}
    found = {}
    for i, segment in segments.items():
        row = next(r for r in range(len(database)) if _shows(database, r, i))
        others = tuple(s for s in segments.values() if s is not segment)
        found[i] = RefineTask(capture.goal, segment, others, int(database.instances[row]), models)
    return found


def _shows(database, row, instance):
    mask = database.regions[row].segment.mask
    truth = database.frame_of(row).true_masks.get(instance)
    return truth is not None and (mask & truth).sum() > 0.9 * mask.sum()


def test_a_fused_model_lies_on_the_object(capture, database, tasks):
    for i, task in tasks.items():
        model, truth = fuse(database, task.instance), capture.truth[i]
        inside = np.linalg.inv(truth.T_world_current)
        local = model.points @ inside[:3, :3].T + inside[:3, 3] - truth.model.box_min
        assert (local > -0.002).all() and (local < truth.model.box_size + 0.002).all()
        assert len(np.unique(np.floor(model.points / 0.002), axis=0)) > 0.6 * len(model.points)
        assert model.seen_by.sum(axis=1).max() >= 2 and model.seen_by.any(axis=1).all()
        np.testing.assert_allclose(np.linalg.norm(model.normals, axis=1), 1, atol=1e-5)
        assert ((model.colors >= 0) & (model.colors <= 255)).all()


def test_clouds_are_the_models_that_are_there_in_the_users_world(database, monkeypatch):
    models = Models(database)
    known = {int(instance): models.get(int(instance)) for instance in np.unique(database.instances)}
    monkeypatch.setattr("toolkit.perception.fusion.fuse", lambda *_: pytest.fail("fused again"))
    T = make_transform(Rotation.from_euler("xyz", [1.2, 0.4, -2.0]).as_matrix(), np.array([0.4, -1.0, 2.0]))
    made = clouds(database.placed(T), models)
    assert made.keys() == known.keys()
    for instance, (points, colors) in made.items():
        np.testing.assert_allclose(points, transform_points(T, known[instance].points), atol=1e-6)
        np.testing.assert_array_equal(colors, known[instance].colors)


def test_normals_of_a_sphere_are_its_radii():
    points = np.random.default_rng(0).standard_normal((2000, 3)).astype(np.float32)
    points /= 20 * np.linalg.norm(points, axis=1, keepdims=True)
    views = np.concatenate([np.eye(3), -np.eye(3)])
    nothing = np.zeros((4, 4), bool)
    patches = tuple(Patch(np.zeros((4, 4, 3), np.uint8), nothing, np.zeros((0, 2)), points[:0], view) for view in views)
    model = FusedModel(points, np.zeros_like(points), points @ views.T > 0, patches)
    assert (model.normals * points).sum(axis=1).min() > 0.98 / 20


def test_a_rim_of_table_is_not_part_of_the_object(database, tasks):
    """Masks that bleed 3 pixels onto the table on every side leave nothing level and low in the model."""
    task = next(iter(tasks.values()))
    rows = database.instance(task.instance)
    clean = fuse(database, task.instance)
    bled = replace(
        database, regions=tuple(_bled(database, k) if k in rows else r for k, r in enumerate(database.regions))
    )
    model = fuse(bled, task.instance)
    low = model.points[:, 2] < 0.003
    assert (model.normals[low, 2] > 0.95).mean() < 0.5
    assert np.abs(model.points[:, :2].max(axis=0) - clean.points[:, :2].max(axis=0)).max() < 0.004


def _bled(database, row):
    region, frame = database.regions[row], database.frame_of(row)
    mask = cv2.dilate(region.segment.mask.astype(np.uint8), np.ones((7, 7), np.uint8)) > 0
    return lift_segment(frame, Segment(mask))


def test_render_compare_finds_the_motions_without_any_start(capture, tasks):
    refiner = REFINERS.create("render_compare")
    for i, task in tasks.items():
        answer = refiner.refine(task)
        assert isinstance(answer, Refined)
        error = pose_error(answer.T_goal_current, capture.truth[i])
        assert error.rotation_error_deg_sym < 2 and error.translation_error_cm_sym < 0.4
        assert any(np.allclose(answer.T_goal_current, T) for T in answer.equivalents)
        spread = np.sqrt(np.diag(answer.covariance))
        assert (spread[[2, 3, 4]] > 0).all() and (spread[[0, 1, 5]] == 0).all()
        assert spread[2] < np.radians(3) and spread[3] < 0.01


@pytest.mark.parametrize("prior", ["planar", "none"])
def test_photometric_sharpens_a_start(capture, tasks, prior):
    refiner = REFINERS.create("photometric", {"prior": prior})
    better = 0
    for i, task in tasks.items():
        truth = capture.truth[i].T_goal_current
        center = truth[:3, :3] @ fuse_center(task) + truth[:3, 3]
        turn = rotation_z(np.radians(4))[:3, :3]
        off = make_transform(turn, center + np.array([0.004, -0.003, 0]) - turn @ center) @ truth
        answer = refiner.refine(replace(task, starts=(Start(off),)))
        before, after = (pose_error(T, capture.truth[i]) for T in (off, answer.T_goal_current))
        better += after.rotation_error_deg < 0.5 * before.rotation_error_deg
    assert better >= len(tasks) - 1


def fuse_center(task):
    return task.models.get(task.instance).center


@pytest.fixture(scope="module")
def unaligned(tasks):
    """Source, goal, rotation and place of a model that lies beside its goal, tilted, in float64."""
    task = next(iter(tasks.values()))
    cloud = Cloud(task.models.get(task.instance), LEVELS_PX, np.zeros(3))
    patch = cloud.patch(0, np.eye(3), cloud.model.patches[0].observation)
    goal = view_goal(task.goal, task.segment, ()).image
    truth = RenderCompare().refine(task).T_goal_current
    turn = Rotation.from_rotvec([0.06, -0.04, 0.1]).as_matrix() @ truth[:3, :3]
    place = transform_points(truth, cloud.center) + np.array([0.004, -0.003, 0.002])
    with jax.enable_x64(True):
        source, goal, turn, place = jax.tree.map(
            lambda part: jnp.asarray(part, jnp.float64), (alignment.Source(*patch, cloud.points), goal, turn, place)
        )
    return source, goal, turn, place


def derivatives(residuals, turn, place, step=1e-6):
    """(..., 6) numeric derivatives of residuals by (turn, shift)."""
    columns = []
    for delta in step * jnp.eye(6):
        ahead, behind = (residuals(rotation_exp(s * delta[:3]) @ turn, place + s * delta[3:]) for s in (1, -1))
        columns.append((ahead - behind) / (2 * step))
    return np.stack(columns, axis=-1)


def equations(residuals, weights, turn, place):
    """Gauss-Newton matrix and gradient of (M, C) residuals with (M,) weights, by numeric derivatives."""
    J, r = derivatives(residuals, turn, place), np.asarray(residuals(turn, place))
    return np.einsum("m,mck,mcl->kl", weights, J, J), np.einsum("m,mck,mc->k", weights, J, r)


@pytest.mark.parametrize("moves", [np.ones(6), np.array([0, 0, 1, 1, 1, 0])], ids=["free", "planar"])
def test_the_gauss_newton_equations_are_those_of_the_four_residuals(unaligned, moves, monkeypatch):
    """Each residual written down again, differentiated numerically, weighted, and summed."""
    source, goal, turn, place = unaligned
    with jax.enable_x64(True):
        pixels = seen(source.shape, goal, turn, place)
        nearest = alignment._nearest(*(x.astype(jnp.float32) for x in (goal.contour, *pixels.T)))
    monkeypatch.setattr(alignment, "_nearest", lambda queries, u, v: nearest)
    level, table, part = 1, 0.001, np.asarray(goal.contour_weight).sum() / len(source.shape)

    def photometric(R, t):
        values, *_ = alignment._sample(goal.values[level], *seen(source.points, goal, R, t).T)
        return jnp.stack(values, axis=1) - source.values[level]

    def inside(R, t):
        (distance,), *_, near = alignment._sample(goal.outside[..., None], *seen(source.shape, goal, R, t).T)
        return (jnp.maximum(distance - 0.5, 0) * near)[:, None]

    def outline(R, t):
        gap = goal.contour - seen(source.shape, goal, R, t)[nearest]
        return (goal.normals * gap).sum(axis=1, keepdims=True) - 0.5

    def contact(R, t):
        return (lowest @ ((source.shape @ R.T + t)[:, 2] - table))[None, None]

    with jax.enable_x64(True):
        lowest = jax.nn.softmax(-(source.shape @ turn.T + place)[:, 2] / alignment._CONTACT_M)
        near = alignment._sample(goal.values[level], *seen(source.points, goal, turn, place).T)[-1]
        off = (photometric(turn, place) ** 2).sum(axis=1) / (3 * alignment._PHOTO_SIGMA) ** 2
        trust = near * source.weights * alignment._PHOTO_SHARE / alignment._PHOTO_SIGMA**2

        def edge(residuals, weight):
            r = residuals(turn, place)[:, 0]
            return weight / (1 + (r / alignment._EDGE_REACH_PX) ** 2) ** 2 / alignment._EDGE_SIGMA_PX**2

        weights = {
            photometric: trust / (1 + off) ** 2,
            inside: edge(inside, part * (inside(turn, place)[:, 0] > 0)),
            outline: edge(outline, goal.contour_weight),
            contact: np.ones(1) / alignment._CONTACT_M**2,
        }
        free = alignment.Freedom(*(jnp.asarray(v, jnp.float64) for v in (moves, 1.0, table)))
        images = goal.values[level], source.values[level]
        found = alignment._normal_equations(turn, place, source, goal, images, free)
        shape, points = (alignment._seen(x, turn, place, goal) for x in (source.shape, source.points))
        in_camera = {
            photometric: alignment._photometric(points, source.weights, images),
            inside: alignment._inside(shape, goal),
            outline: alignment._outline(shape, goal),
        }
        axes = np.kron(np.eye(2), goal.R)
        terms = {term: (axes.T @ H @ axes, axes.T @ gradient) for term, (H, gradient) in in_camera.items()}
        terms[contact] = alignment._contact(source.shape, turn, place, free)
        expected = {r: equations(r, np.asarray(w), turn, place) for r, w in weights.items()}
    total = [sum(parts) for parts in zip(*expected.values(), strict=True)]
    masked = total[0] * np.outer(moves, moves), total[1] * moves
    for (H, gradient), (want_H, want_gradient) in [(found, masked), *((terms[r], expected[r]) for r in weights)]:
        assert np.abs(want_H).max() > 1 and np.abs(want_gradient).max() > 1
        np.testing.assert_allclose(H, want_H, rtol=1e-3, atol=1e-3 * np.abs(want_H).max())
        np.testing.assert_allclose(gradient, want_gradient, rtol=1e-3, atol=1e-3 * np.abs(want_gradient).max())


def seen(points, goal, R, t):
    """(M, 2) pixels of the crop that (M, 3) model points are seen at: the pinhole camera, written down again."""
    camera = (points @ R.T + t) @ goal.R.T + goal.t
    return (camera @ goal.K.T)[:, :2] / camera[:, 2:]


def test_normalised_images_ignore_light_and_background():
    rng = np.random.default_rng(0)
    rgb = np.kron(rng.integers(60, 180, (16, 16, 3)), np.ones((6, 6, 1))).astype(np.uint8)
    mask = np.zeros(rgb.shape[:2], bool)
    mask[20:70, 15:80] = True
    on_mask = Normalizer(mask, 1.0)
    plain = on_mask.normalized(opponent(rgb))
    other = np.where(mask[..., None], rgb * 0.9 + 20, rng.integers(0, 255, rgb.shape)).astype(np.uint8)
    lit = on_mask.normalized(opponent(other))
    assert np.corrcoef(plain[mask].ravel(), lit[mask].ravel())[0, 1] > 0.99
    assert (plain[~mask] == 0).all()


def box_points(size, noise=0.0):
    """Points on the surface of a box of (3,) sides, its centre at the origin."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-0.5, 0.5, (4000, 3))
    side = rng.integers(3, size=len(points))
    points[np.arange(len(points)), side] = np.sign(points[np.arange(len(points)), side]) / 2
    return points * size + rng.normal(0, noise, points.shape) if noise else points * size


def test_rotations_are_proper_and_reach_everywhere():
    everywhere = resting_rotations(box_points([0.04, 0.08, 0.14]), 26, 24)
    for R in (yaw_rotations(72), everywhere):
        np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(R), 1)
    np.testing.assert_allclose(everywhere[0], np.eye(3), atol=1e-12)
    for target in Rotation.random(50, rng=np.random.default_rng(0)).as_matrix():
        assert min(rotation_angle(target.T @ R) for R in everywhere) < np.radians(40)


def test_a_box_may_have_been_put_on_each_of_its_sides():
    turned = box_points([0.04, 0.08, 0.14], noise=0.0003) @ Rotation.from_euler("z", 20, degrees=True).as_matrix().T
    ups = resting_rotations(turned, 6, 1)[:, 2]
    sides = np.concatenate([np.eye(3), -np.eye(3)]) @ Rotation.from_euler("z", -20, degrees=True).as_matrix()
    assert (np.degrees(np.arccos((sides @ ups.T).max(axis=1).clip(-1, 1))) < 3).all()


def test_a_flat_object_has_no_hull_to_rest_on():
    sheet = np.random.default_rng(0).uniform(-0.05, 0.05, (500, 3)) * [1, 1, 0]
    assert resting_rotations(sheet, 8, 4).shape == (32, 3, 3)


def test_nothing_recompiles_after_warm_up(tasks):
    refiner = REFINERS.create("render_compare")
    for task in tasks.values():
        refiner.refine(task)
        refiner.refine(replace(task, starts=(Start(np.eye(4)),)))
    compilations = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compilations.append(event) if "backend_compile" in event else None
    )
    for task in tasks.values():
        REFINERS.create("render_compare").refine(replace(task, starts=(Start(rotation_z(1.0)),), others=()))
    assert not compilations
    jax.jit(lambda x: x + 1)(jnp.ones(3))
    assert compilations  # they would have been noticed


def test_a_refiner_lets_go_of_scenes_that_are_done(tasks):
    """A worker refines hundreds of scenes with one refiner."""
    refiner, task = REFINERS.create("photometric"), next(iter(tasks.values()))
    models = Models(task.models._database)
    refiner.refine(replace(task, models=models, starts=(Start(np.eye(4)),)))
    kept = weakref.ref(models.get(task.instance))
    del models
    gc.collect()
    assert kept() is None


def test_the_same_task_gives_the_same_bytes(tasks):
    task = next(iter(tasks.values()))
    a, b = (REFINERS.create("render_compare").refine(task).T_goal_current.tobytes() for _ in range(2))
    assert a == b


def test_little_confidence_is_an_abstention(tasks):
    task = next(iter(tasks.values()))
    answer = REFINERS.create("render_compare", {"abstain_below": 1.0}).refine(task)
    assert isinstance(answer, Abstention) and "confidence" in answer.reason


def test_a_hidden_side_is_said_to_be_hidden(tasks):
    """Two motions that score alike: named symmetric where nothing tells them apart, hidden where the far side would."""
    task = next(iter(tasks.values()))
    model = task.models.get(task.instance)
    center = model.center
    half_turn = rotation_z(np.pi)
    half_turn[:3, 3] = center - half_turn[:3, :3] @ center
    first = Hypothesis(half_turn, 0.9, 1.0, 0.5, 0.1, 0.6, 1.0, np.eye(6))
    second = replace(first, T_goal_current=np.eye(4), iou=0.89)
    hidden = judge([first, second], _two_coloured(model, center), (), 0.03)
    assert hidden.ambiguity == "hidden" and hidden.best is first and len(hidden.equivalents) == 2
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 180, endpoint=False), np.linspace(0, 0.1, 40))
    can = np.stack([0.04 * np.cos(angle), 0.04 * np.sin(angle), height], axis=-1).reshape(-1, 3) + center
    symmetric = judge([first, second], _likeness_model(can), (), 0.03)
    assert symmetric.ambiguity == "symmetric" and symmetric.best is second
    alone = judge([first, replace(second, iou=0.5)], _likeness_model(can), (), 0.03)
    assert alone.ambiguity == "none" and alone.equivalents == (first,)
    assert hidden.confidence < symmetric.confidence


def _two_coloured(model, center):
    left = model.points[:, 0] < center[0]
    return replace(model, colors=np.where(left[:, None], [200, 30, 30], [30, 30, 200]).astype(np.float32))


def test_a_mask_of_the_wrong_object_lowers_the_confidence(tasks):
    refiner = REFINERS.create("render_compare")
    first, second, *_ = tasks.values()
    right, wrong = refiner.refine(first), refiner.refine(replace(first, segment=second.segment, others=()))
    assert isinstance(wrong, Failure) or wrong.confidence < right.confidence


def test_too_few_points_are_a_failure(capture, database):
    rows = database.instance(0)
    tiny = replace(database, regions=tuple(_shrunk(r) if k in rows else r for k, r in enumerate(database.regions)))
    answer = fuse(tiny, 0)
    assert isinstance(answer, Failure) and "points" in answer.reason


def _shrunk(region):
    return replace(region, points=region.points[:1], pixels=region.pixels[:1])


def test_a_few_pixels_of_an_object_are_not_judged(tasks):
    task = next(iter(tasks.values()))
    mask = np.zeros_like(task.segment.mask)
    mask[240, 320] = True
    answer = REFINERS.create("render_compare").refine(replace(task, segment=Segment(mask)))
    assert isinstance(answer, Abstention) and "1 pixels of the object are in view" in answer.reason
    tried = REFINERS.create("render_compare", {"min_pixels": 1}).refine(replace(task, segment=Segment(mask)))
    assert isinstance(tried, (Refined, Failure))


def test_one_view_only_is_enough_to_try(capture):
    estimates = make_pipeline("render_compare", views=1).run(capture)
    assert all(e.status in {"estimated", "failed"} for e in estimates)


def test_photometric_without_a_start_is_a_failure(tasks):
    answer = REFINERS.create("photometric").refine(next(iter(tasks.values())))
    assert isinstance(answer, Failure) and "no motion" in answer.reason


def test_the_pipeline_is_better_with_render_compare(capture):
    plain, refined = (score(capture, make_pipeline(name).run(capture)) for name in ("none", "render_compare"))
    assert sum(r.success_sym for r in refined) >= sum(r.success_sym for r in plain)
    assert np.median([r.rotation_error_deg_sym for r in refined]) < 1.0
    assert all(0 <= r.confidence <= 1 for r in refined)


def test_an_assignment_gives_every_instance_once():
    """Two goal objects that both look most like instance 0."""
    similarity = np.array([[0.9, 0.9, 0.5, 0.5], [0.95, 0.95, 0.9, 0.9]])
    instances = np.array([0, 0, 1, 1])
    scores = instance_similarity(similarity, instances)
    np.testing.assert_allclose(scores, [[0.9, 0.5], [0.95, 0.9]])
    unseen = np.full(scores.shape, np.nan)
    assert assign_instances(scores, unseen).tolist() == [0, 1]
    assert assign_instances(np.tile(scores, (2, 1)), np.tile(unseen, (2, 1))).tolist().count(-1) == 2
    assert restrict(np.array([3, 0, 2, 1]), instances, 1).tolist() == [3, 2]
    assert restrict(np.array([3, 0]), instances, -1).tolist() == [3, 0]


def test_where_descriptors_cannot_tell_the_models_decide():
    """Objects 0 and 1 contend for instances 0 and 1; object 2 is alone with instance 2."""
    scores = np.array([[0.80, 0.78, 0.2], [0.81, 0.78, 0.2], [0.3, 0.2, 0.9]])
    assert contenders(scores).tolist() == [[True, True, False], [True, True, False], [False, False, False]]
    verified = np.where(contenders(scores), [[0.4, 1.6, 0], [1.5, 0.5, 0], [0, 0, 0]], np.nan)
    assert assign_instances(scores, verified).tolist() == [1, 0, 2]


@pytest.mark.parametrize("kind", ["twins", "recolored"])
def test_lookalikes_are_told_apart_or_shared_out(cache, tmp_path, kind):
    pytest.importorskip("pybullet")
    config = TabletopConfig(
        scenes=1, seed=3, min_objects=2, max_objects=2, views=4, rotation_deg=60, lookalikes=kind, renderer="tiny"
    )
    capture = load_capture(build_dataset(config, tmp_path / kind, cache) / "000000")
    estimates = make_pipeline("render_compare", assignment="global").run(capture)
    assert len({e.instance for e in estimates}) == 2
    assert all(row.success_sym for row in score(capture, estimates))


def test_objects_that_were_tipped_over_lie_on_the_table(cache, tmp_path):
    pytest.importorskip("pybullet")
    config = TabletopConfig(scenes=1, seed=4, min_objects=3, max_objects=3, poses="stable", renderer="tiny")
    capture = load_capture(build_dataset(config, tmp_path / "tipped", cache) / "000000")
    assert sum(rotation_angle(_about_horizontal(t.T_goal_current)) > 0.5 for t in capture.truth.values()) >= 2
    pipeline = make_pipeline("render_compare", {"prior": "resting"})
    estimates = pipeline.run(capture)
    models = Models(pipeline.build_database(capture.current))
    for estimate in estimates:
        moved = transform_points(estimate.T_goal_current, models.get(estimate.instance).points)
        assert -0.004 < moved[:, 2].min() < 0.008
    assert sum(row.success_sym for row in score(capture, estimates)) >= 2


def _about_horizontal(T):
    """The part of a turn that tips: what is left between the vertical and where it goes."""
    return Rotation.align_vectors([T[:3, 2]], [[0, 0, 1]])[0].as_matrix()


def test_clouds_have_one_shape(database):
    big = fuse(database, 0)
    small = FusedModel(big.points[:40], big.colors[:40], big.seen_by[:40], big.patches)
    for model in (big, small):
        cloud = Cloud(model, LEVELS_PX, np.zeros(3))
        assert cloud.points.shape == cloud.normals.shape == cloud.colors.shape == (1280, 3)
        assert cloud.patch(0, np.eye(3), np.array([0.0, 0.0, 1.0]))[0].shape == (768, 3)
        assert cloud.valid.sum() == min(len(model.points), 1024)


def test_the_light_is_found_on_objects_of_any_colour():
    """Spheres of different colours under one light: the slope of log brightness is the light that was put in."""
    light, rng = np.array([0.1, -0.25, 0.15]), np.random.default_rng(0)
    models = []
    for tint in ([200, 60, 60], [90, 120, 90], [60, 60, 180]):
        normals = rng.standard_normal((1500, 3)).astype(np.float32)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        colors = np.array(tint) * np.exp(normals @ light)[:, None] * rng.uniform(0.95, 1.05, (1500, 1))
        patch = Patch(
            np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), bool), np.zeros((0, 2)), normals[:0], np.eye(3)[2]
        )
        models.append(FusedModel(0.05 * normals, colors.astype(np.float32), np.ones((1500, 1), bool), (patch,)))
    # One camera looks down: normals of the lower half point the wrong way, so only the upper half is kept.
    models = [replace(m, points=m.points[up], colors=m.colors[up], seen_by=m.seen_by[up]) for m, up in _upper(models)]
    np.testing.assert_allclose(estimate_light(models), light, atol=0.04)
    assert (estimate_light([]) == 0).all()


def _upper(models):
    return [(model, model.points[:, 2] > 0.01) for model in models]


def test_a_turned_surface_is_shaded_by_its_new_normal():
    light, normals = np.array([0.0, -0.3, 0.1]), np.array([[0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    factors = relit(light, normals, Rotation.from_euler("z", [[0], [np.pi]]).as_matrix())
    np.testing.assert_allclose(factors, [[1, 1], [np.exp(-0.6), 1]], atol=1e-12)


def test_likeness_knows_a_symmetry_from_a_handle():
    """A cylinder looks the same after any turn; with a handle it does not, and a half turn of a box does."""
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 180, endpoint=False), np.linspace(0, 0.1, 40))
    can = np.stack([0.04 * np.cos(angle), 0.04 * np.sin(angle), height], axis=-1).reshape(-1, 3)
    handle = np.stack(np.meshgrid(np.linspace(0.04, 0.08, 20), [0.0, 0.004], np.linspace(0.03, 0.07, 20)), -1)
    turns = [np.eye(4), rotation_z(np.radians(40)), rotation_z(np.pi)]
    plain, handled = (_likeness_model(points) for points in (can, np.concatenate([can, handle.reshape(-1, 3)])))
    assert unlikeness(plain, turns).max() < 0.02
    assert unlikeness(handled, turns)[0] == 0 and unlikeness(handled, turns)[1:].min() > 0.08
    half = can.copy()
    half[:, 0] *= 0.5
    assert unlikeness(_likeness_model(half), turns)[1] > 0.3 and unlikeness(_likeness_model(half), turns)[2] < 0.02


def _likeness_model(points):
    points = points.astype(np.float32)
    patch = Patch(np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), bool), np.zeros((0, 2)), points[:0], np.eye(3)[2])
    return FusedModel(points, np.full_like(points, 128), np.ones((len(points), 1), bool), (patch,))


def test_two_routes_are_joined_by_how_exact_each_is():
    """The image knows the turn, the matches know the place: the answer takes each from where it is known."""
    center, free = np.array([0.2, 0.1, 0.05]), np.array([0, 0, 1, 1, 1, 0.0])
    image, matches = rotation_z(0.3), rotation_z(0.32)
    image[:2, 3] += [0.002, 0.0]
    sharp_turn, sharp_place = np.diag([0, 0, 1e-8, 1e-5, 1e-5, 0]), np.diag([0, 0, 1e-3, 1e-9, 1e-9, 0])
    T, covariance = combine(image, sharp_turn, center, Start(matches, sharp_place, center), free)
    assert abs(np.arctan2(T[1, 0], T[0, 0]) - 0.3) < 0.002
    assert np.linalg.norm(T[:3, :3] @ center + T[:3, 3] - matches[:3, :3] @ center - matches[:3, 3]) < 1e-4
    assert (np.diag(covariance)[[2, 3, 4]] < np.diag(sharp_turn + sharp_place)[[2, 3, 4]]).all()
    assert (covariance[[0, 1, 5]] == 0).all()


def test_a_covariance_moves_with_the_point_it_is_about():
    """Sampled: the shift of a far point, whose own place is uncertain by the turn as well."""
    rng, start = np.random.default_rng(0), np.diag([0, 0, 1e-4, 1e-6, 2e-6, 0])
    known, far = np.array([0.1, 0.0, 0.0]), np.array([0.1, 0.2, 0.0])
    samples = rng.multivariate_normal(np.zeros(6), start, 20000)
    moved = samples[:, 3:] + np.cross(samples[:, :3], far - known)
    moved_covariance = _about(Start(np.eye(4), start, known), far)
    np.testing.assert_allclose(moved_covariance[3:5, 3:5], np.cov(moved.T)[:2, :2], rtol=0.05, atol=1e-8)


def test_support_by_matches_is_told_from_none(tasks):
    task = next(iter(tasks.values()))
    found = REFINERS.create("render_compare").refine(task)
    supported, repeated = (
        REFINERS.create("render_compare").refine(
            replace(task, starts=(Start(found.T_goal_current, independent=independent),))
        )
        for independent in (True, False)
    )
    assert supported.confidence > found.confidence
    assert repeated.confidence == pytest.approx(found.confidence, abs=0.01)
