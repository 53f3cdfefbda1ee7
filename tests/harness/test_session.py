"""A session: the same models for one scene after another, and the same bytes for the same scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import toolkit
from toolkit.errors import ToolkitError
from toolkit.geometry import invert
from toolkit.harness.experiment import load_experiment, only_cell
from toolkit.perception.checks.capture import RefusedError
from toolkit.plugin_kit.conformance.raycast import NOW, THEN, camera, shoot
from toolkit.plugin_kit.conformance.scene import current_frames, goal_frame

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.fixture(scope="module")
def session():
    return toolkit.Session("estimate")


def as_bytes(estimates):
    parts = []
    for e in estimates:
        motion = b"" if e.T_goal_current is None else e.T_goal_current.tobytes()
        parts.append((e.goal_object, e.instance, motion, e.confidence, e.segment.mask.tobytes()))
    return parts


def test_twice_on_one_capture_gives_identical_bytes(session):
    session.database(current_frames())
    first = as_bytes(session.estimate(goal_frame()))
    other = shoot(0, camera(-80), THEN[::-1], depth=False, print_contrast=0.9)
    session.estimate(other)
    again = as_bytes(session.estimate(goal_frame()))
    session.database([shoot(i, camera(90 * i), NOW[:2], print_contrast=0.9) for i in range(4)])
    session.database(current_frames())
    anew = as_bytes(session.estimate(goal_frame()))
    assert any(motion for _, _, motion, _, _ in first)
    assert first == again == anew
    assert session.findings == []


def test_a_capture_that_cannot_be_right_is_refused_and_the_session_goes_on(session):
    flipped = [
        replace(f, camera=replace(f.camera, T_world_camera=f.camera.T_world_camera @ FLIP)) for f in current_frames()
    ]
    with pytest.raises(RefusedError, match="OpenGL"):
        session.database(flipped)
    with pytest.raises(ToolkitError, match="call `database` first"):
        session.estimate(goal_frame())
    session.database(current_frames())
    for wrong, cause in ((lambda T: T @ FLIP, "OpenGL"), (invert, "camera-to-world")):
        with pytest.raises(RefusedError, match=cause):
            away = replace(goal_frame().camera, T_world_camera=wrong(goal_frame().camera.T_world_camera))
            session.estimate(replace(goal_frame(), camera=away))
    assert session.findings[0].severity == "refused"
    assert session.estimate(goal_frame())


def test_doubt_caps_what_a_session_says(session):
    dark = replace(goal_frame(), rgb=(goal_frame().rgb // 12).astype(np.uint8))
    session.database(current_frames())
    estimates = session.estimate(dark)
    assert [f.severity for f in session.findings] == ["doubtful"]
    assert all(e.confidence is None or e.confidence <= session.findings[0].cap for e in estimates)


def test_a_session_takes_settings_that_were_read_and_no_sweep():
    cell = only_cell(load_experiment("estimate"))
    assert toolkit.Session(cell).weights == toolkit.Session("estimate").weights
    with pytest.raises(ToolkitError, match="one setting is run here"):
        toolkit.Session("matchers")
    with pytest.raises(AttributeError, match="nothing"):
        toolkit.nothing  # noqa: B018
