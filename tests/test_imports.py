"""Imports go one way, a stage's folder is its menu, and the command line starts without anything heavy."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import toolkit
from toolkit.stages import REGISTRIES

ROOT = Path(toolkit.__file__).parent

LAYERS = [
    {"errors", "slots", "settings", "paths", "progress", "files"},
    {"geometry", "parallel"},
    {"types", "weights"},
    {"digests", "registry", "models", "sim", "results"},
    {"data", "perception"},
    {"rearrangement", "stages", "pictures", "training"},
    {"harness", "plugin_kit", "serving"},
    {"cli"},
]
"""Parts of the package, from the ground up: one may import from those before it, and beside it without a circle."""

WINGS = ("perception", "rearrangement")
"""Their folders are stages. What stages are made of comes before `stages.py`, what joins them after the folders."""

SHARED = {"tabletop", "checks"}
"""Folders that are no stages: what several stages are made of, and what captures are checked with."""

HEAVY = {
    *("cv2", "faiss", "fastapi", "jax", "joblib", "kornia", "matplotlib", "numpy", "onnxruntime", "pybullet"),
    *("rerun", "scipy", "sklearn", "torch", "trimesh", "uvicorn"),
}
"""What no command imports before it needs it: the budget of the start, without a clock."""

JOINING = {"perception": {"parts", "ranking", "search", "scene", "pipeline"}, "rearrangement": {"sight", "episode"}}


def layer(part: str) -> int:
    return next(i for i, parts in enumerate(LAYERS) if part in parts)


def imports() -> list[tuple[Path, list[str], list[str]]]:
    """(file, its place, the place it imports from), places as paths below the package."""
    found = []
    for path in sorted(ROOT.rglob("*.py")):
        own = list(path.relative_to(ROOT).with_suffix("").parts)
        if own[0] in {"__init__", "experiments"}:
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("toolkit."):
                found.append((path, own, node.module.split(".")[1:]))
    return found


def test_imports_go_one_way():
    wrong = [
        f"{path.relative_to(ROOT)} imports toolkit.{used[0]}"
        for path, own, used in imports()
        if own[0] != used[0] and layer(used[0]) > layer(own[0])
    ]
    assert not wrong, "\n".join(wrong)


def test_no_two_parts_import_each_other():
    uses: dict[str, set[str]] = {}
    for _, own, used in imports():
        if own[0] != used[0]:
            uses.setdefault(own[0], set()).add(used[0])

    def reach(part: str, seen: set[str]) -> set[str]:
        for other in uses.get(part, set()) - seen:
            reach(other, seen | {other})
            seen |= {other, *reach(other, seen)}
        return seen

    assert not [part for part in uses if part in reach(part, set())]


@pytest.mark.parametrize("wing", WINGS)
def test_inside_a_wing_imports_go_from_parts_to_stages_to_what_joins_them(wing):
    folders = {path.name for path in (ROOT / wing).iterdir() if path.is_dir()} - SHARED

    def floor(place: list[str]) -> int:
        name = place[1] if len(place) > 1 else "__init__"
        return 3 if name in JOINING[wing] else 2 if name in folders else 1 if name == "stages" else 0

    wrong = [
        f"{path.relative_to(ROOT)} imports {'.'.join(used)}"
        for path, own, used in imports()
        if own[0] == used[0] == wing
        and (floor(used) > floor(own) or (floor(own) == 2 == floor(used) and own[1] != used[1]))
    ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize("stage", REGISTRIES)
def test_a_stages_folder_is_its_menu(stage):
    builtins = {entry.name: entry.target for entry in REGISTRIES[stage].entries() if entry.origin == "toolkit"}
    modules = {name: target.partition(":")[0] for name, target in builtins.items()}
    assert {name: module.rpartition(".")[2] for name, module in modules.items()} == {name: name for name in builtins}
    (package,) = {module.rpartition(".")[0] for module in modules.values()}
    folder = ROOT.joinpath(*package.split(".")[1:])
    assert {path.stem for path in folder.glob("*.py")} == {"__init__", *builtins}


def test_the_command_line_starts_without_anything_heavy():
    code = "import sys, toolkit.cli.commands; print(*{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
    assert "typer" in done.stdout.split()
    assert not HEAVY & set(done.stdout.split())
