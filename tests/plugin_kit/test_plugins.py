"""The plugins of plugins/: they import public names only, and pass the checks of their stage and their own tests."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
OPTIONS = ("-o", "addopts=", "-q", "-p", "toolkit.plugin_kit.pytest_plugin", "-p", "no:cacheprovider")
PLUGINS = sorted(path.parent for path in (ROOT / "plugins").glob("*/pyproject.toml"))


def test_there_are_plugins():
    assert PLUGINS


@pytest.mark.parametrize("folder", PLUGINS, ids=lambda folder: folder.name)
def test_only_public_names_are_imported(folder):
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "toolkit":
                names = [*node.module.split("."), *(alias.name for alias in node.names)]
                assert not [name for name in names if name.startswith("_")], path


def test_their_own_tests_pass():
    """In one process, which imports and compiles what they share once."""
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *OPTIONS, *(str(folder / "tests") for folder in PLUGINS)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (*PLUGINS, ROOT)))},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("folder", PLUGINS, ids=lambda folder: folder.name)
def test_its_entry_points_name_what_it_has(folder):
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    for group, points in project.get("entry-points", {}).items():
        for name, target in points.items():
            module, _, attribute = target.partition(":")
            source = ast.parse((folder / f"{module.replace('.', '/')}.py").read_text())
            classes = {node.name: node for node in source.body if isinstance(node, ast.ClassDef)}
            assert group.startswith("toolkit.") and attribute in classes
            named = [n.value.value for n in classes[attribute].body if _sets(n, "name")]
            assert named == [name]


def _sets(node, attribute):
    return isinstance(node, ast.Assign) and [getattr(t, "id", None) for t in node.targets] == [attribute]
