"""Imports go one way (DESIGN 2), and the command line starts without anything heavy."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import toolkit

ROOT = Path(toolkit.__file__).parent
STAGE_FOLDERS = (
    "registration",
    "segmenters",
    "associators",
    "descriptors",
    "indexes",
    "retrieval",
    "matchers",
    "pnp",
    "refiners",
    "planners",
    "grasps",
    "motion",
)

LAYERS = [
    {"errors", "slots", "paths", "meter", "progress", "files"},
    {"geometry", "jax_geometry", "paper_figures"},
    {"types"},
    {"footprints"},
    {"moves"},
    {"registry", "crops", "regions", "lifting", "digests", "stats", "metrics", "weights", "models"},
    {"parallel"},
    {
        "stages",
        "database",
        "fusion",
        "lighting",
        "plane",
        "assignment",
        "results",
        "completion",
        "pictures",
        "sim",
    },
    {"tables"},
    {"comparisons"},
    set(STAGE_FOLDERS),
    {"pipeline", "sight", "episode", "cache", "data", "report"},
    {"executors"},
    {"experiment", "evaluate", "runs", "doctor", "recording", "film"},
    {"worker"},
    {"ablate", "estimate", "rearrange", "training", "conformance", "scaffold", "attribution", "view", "merge"},
    {"pytest_plugin"},
    {"options"},
    {"cli"},
]
"""A module may import from its own layer and those before it."""


def layer(part: str) -> int:
    return next(i for i, parts in enumerate(LAYERS) if part in parts)


def imports() -> list[tuple[Path, str, str]]:
    found = []
    for path in sorted(ROOT.rglob("*.py")):
        own = path.relative_to(ROOT).parts[0].removesuffix(".py")
        if own in {"__init__", "experiments"}:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("toolkit."):
                found.append((path, own, node.module.split(".")[1]))
    return found


def test_imports_go_one_way():
    wrong = [
        f"{path.relative_to(ROOT)} imports toolkit.{used}"
        for path, own, used in imports()
        if own != used and layer(used) > layer(own)
    ]
    assert not wrong, "\n".join(wrong)


def test_a_stage_knows_none_of_its_neighbours():
    wrong = [
        f"{path.relative_to(ROOT)} imports toolkit.{used}"
        for path, own, used in imports()
        if own in STAGE_FOLDERS and used in STAGE_FOLDERS and own != used
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("heavy", ["torch", "jax", "cv2", "numpy", "pybullet", "kornia", "faiss", "rerun"])
def test_the_command_line_starts_without(heavy):
    code = f"import sys, toolkit.cli; sys.exit({heavy!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
