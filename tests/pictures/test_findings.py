"""A finding comes with a picture that shows it, named in its sentence."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from toolkit.cli.commands import app
from toolkit.data.bop import write_capture
from toolkit.perception.checks.capture import RefusedError, check_current, check_goal
from toolkit.pictures.findings import cameras_picture, illustrated, table_picture
from toolkit.plugin_kit.conformance.scene import current_frames, dark_frame, goal_frame
from toolkit.types import Finding

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def posed(frame, change):
    return replace(frame, camera=replace(frame.camera, T_world_camera=change(frame.camera.T_world_camera)))


def opengl():
    return [posed(frame, lambda T: T @ FLIP) for frame in current_frames()]


def test_a_finding_about_poses_names_the_picture_of_the_cameras(tmp_path):
    (finding,) = illustrated(tmp_path / "out", opengl(), goal_frame(), check_current(opengl()))
    assert finding.sentence.endswith(f"(see {tmp_path / 'out' / 'cameras.png'})")
    assert cv2.imread(str(tmp_path / "out" / "cameras.png")).shape[2] == 3


def test_a_finding_about_the_goal_names_the_picture_of_the_table(tmp_path):
    away = posed(goal_frame(), lambda T: T @ FLIP)
    (finding,) = illustrated(tmp_path, current_frames(), away, check_goal(away, current_frames()))
    assert f"(see {tmp_path / 'table.png'})" in finding.sentence
    assert (tmp_path / "table.png").is_file() and not (tmp_path / "cameras.png").exists()


def test_what_images_show_themselves_needs_no_picture_and_no_folder(tmp_path):
    findings = [Finding("doubtful", "the goal image is nearly black", 0.3)]
    assert illustrated(tmp_path / "out", current_frames(), goal_frame(), findings) == findings
    assert illustrated(tmp_path / "out", current_frames(), goal_frame(), []) == []
    assert not (tmp_path / "out").exists()


def test_the_table_lies_on_itself_where_poses_are_right_and_not_where_they_are_not():
    def alike(goal):
        picture = cv2.GaussianBlur(cv2.cvtColor(table_picture(current_frames(), goal), cv2.COLOR_RGB2GRAY), (0, 0), 1)
        left, right = picture[:480, :480].astype(float), picture[:480, -480:].astype(float)
        both = (left > 0) & (right > 0)
        return np.corrcoef(left[both], right[both])[0, 1]

    def shifted(T):
        return T + np.array([[0, 0, 0, 0.05], [0] * 4, [0] * 4, [0] * 4])

    assert alike(posed(current_frames()[1], shifted)) < alike(current_frames()[1]) - 0.1


def test_the_cameras_are_drawn_whatever_the_world_and_not_where_no_table_is_seen():
    T = np.array([[0, 0, 1, 3.0], [1, 0, 0, -2], [0, 1, 0, 1], [0, 0, 0, 1]])
    straight, moved, wrong = (
        cameras_picture(frames).astype(int)
        for frames in (current_frames(), [f.moved(T) for f in current_frames()], opengl())
    )
    assert np.abs(straight - moved).mean() < np.abs(straight - wrong).mean() / 3
    assert cameras_picture([dark_frame()]) is None
    assert table_picture([dark_frame()], goal_frame()) is None


@pytest.mark.parametrize("command", [["capture", "check"], ["estimate"]])
def test_commands_write_it_where_answers_go(tmp_path, command):
    write_capture(tmp_path / "gl", opengl(), goal_frame())
    result = CliRunner().invoke(app, [*command, str(tmp_path / "gl"), "--out", str(tmp_path / "out")])
    assert isinstance(result.exception, RefusedError)
    assert str(result.exception).endswith(f"(see {tmp_path / 'out' / 'cameras.png'})")
    assert (tmp_path / "out" / "cameras.png").is_file()
