"""The benchmark of a GPU: whether two devices give the same answers."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np

from toolkit.geometry import make_transform, rotation_z

FOLDER = Path(__file__).parents[2] / "experiments" / "benchmarks"


def test_answers_agree_up_to_their_symmetries(monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    agreement = runpy.run_path(str(FOLDER / "gpu.py"))["agreement"]
    near, far = make_transform(np.eye(3), np.array([0.004, 0, 0])), make_transform(np.eye(3), np.array([0.01, 0, 0]))
    half = rotation_z(np.pi)
    ours = {"0/0": [np.eye(4).tolist()], "0/1": [np.eye(4).tolist(), half.tolist()], "0/2": [half.tolist()]}
    assert agreement(ours, ours) == 1
    theirs = {"0/0": [near.tolist()], "0/1": [half.tolist()], "0/2": [(far @ half).tolist()]}
    assert agreement(ours, theirs) == 2 / 3
    assert agreement(ours, {}) == 0
