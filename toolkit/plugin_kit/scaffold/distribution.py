"""Writes a plugin's distribution: a module with its class and settings, a test, a README and a pyproject.toml."""

from __future__ import annotations

import re
from pathlib import Path

from toolkit.errors import ToolkitError
from toolkit.files import write_text
from toolkit.stages import registry_of

_TEMPLATES = Path(__file__).parent / "templates"

_PYPROJECT = """\
[build-system]
requires = ["hatchling>=1.24"]
build-backend = "hatchling.build"

[project]
name = "toolkit-{dashed}"
version = "0.1.0"
description = "{name}: a {stage} for the rearrangement toolkit"
readme = "README.md"
requires-python = ">=3.11"
dependencies = ["rearrange-toolkit"]

[project.optional-dependencies]
test = ["pytest>=8.3"]

[project.entry-points."{group}"]
{name} = "{module}:{class_name}"

[tool.hatch.build.targets.wheel]
only-include = ["{module}.py"]
"""

_README = """\
# {name}

A {stage} for the rearrangement toolkit. `{module}.py` holds all of it: its settings, and a class that does what
`toolkit.stages` asks of a {stage}.

    pip install -e '.[test]'
    toolkit show {stage} {name}
    toolkit check {stage} {name}
    pytest

Without installing it:

    toolkit check {stage} {name} --plugin {module}.py
{use}
Raise `version` in the class when its outputs change for reasons that its source does not show: cached outputs are kept
by source, settings, weights and inputs.
"""

_TEST = """\
from {module} import {class_name}

from toolkit.plugin_kit.conformance import Conforms


class Test{class_name}(Conforms):
    plugin = {class_name}
"""

_ABLATED = (
    "registration",
    "segmenter",
    "associator",
    "explainer",
    "descriptor",
    "index",
    "retriever",
    "matcher",
    "pnp",
    "refiner",
)
_REARRANGED = ("planner", "executor")
_BY_THE_ARM = ("grasp", "motion")


def new_plugin(stage: str, name: str, out: Path | None = None) -> Path:
    """Write a distribution that passes `toolkit check STAGE NAME` as it stands.

    Args:
        stage: singular stage name.
        name: the plugin's name: lower-case letters, digits and _, a letter first.
        out: the folder to make; toolkit-NAME in the current one when None.

    Returns:
        The folder.

    Raises:
        ToolkitError: an unknown stage, a name that cannot be used or is taken, or a folder that holds something.
    """
    registry = registry_of(stage)
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ToolkitError(f"'{name}' cannot be a plugin's name: use a-z, 0-9 and _, a letter first")
    if name in registry.names():
        raise ToolkitError(f"there is a {stage} '{name}' already; choose another name")
    folder = out or Path(f"toolkit-{name.replace('_', '-')}")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise ToolkitError(f"'{folder}' is there already and not empty; name a new folder with --out")
    words = {
        "name": name,
        "dashed": name.replace("_", "-"),
        "stage": stage,
        "group": registry.group,
        "module": f"toolkit_{name}",
        "class_name": "".join(part.capitalize() for part in name.split("_")),
        "use": _use(stage, name),
    }
    (folder / "tests").mkdir(parents=True, exist_ok=True)
    write_text(folder / "pyproject.toml", _PYPROJECT.format(**words))
    write_text(folder / "README.md", _README.format(**words))
    write_text(folder / "tests" / f"test_{name}.py", _TEST.format(**words))
    write_text(folder / f"{words['module']}.py", _module(stage, name, words["class_name"]))
    return folder


def _module(stage: str, name: str, class_name: str) -> str:
    source = (_TEMPLATES / f"{stage}.py").read_text()
    return source.replace("Template", class_name).replace("template", name)


def _use(stage: str, name: str) -> str:
    if stage in _ABLATED:
        return f"\nMeasure it beside another one:\n\n    toolkit ablate --{stage} {name} --{stage} OTHER\n"
    if stage in _BY_THE_ARM:
        return f"\nUse it:\n\n    toolkit rearrange --executor arm --set rearrange.executor.{stage}.name={name}\n"
    assert stage in _REARRANGED
    return f"\nUse it:\n\n    toolkit rearrange --{stage} {name}\n"
