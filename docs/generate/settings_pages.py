"""One page with every setting there is: of an experiment, of every implementation, of files, and of training."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from toolkit.data.exporting import EXPORTERS
from toolkit.data.importing import IMPORTERS
from toolkit.data.tabletop import TabletopConfig
from toolkit.harness.experiment import CellSpec, Experiment, NamedValue, PipelineChoice, RearrangeChoice
from toolkit.registry import Registry, StageChoice
from toolkit.sim.robots import RobotFile
from toolkit.slots import REARRANGE_SLOTS, SLOTS
from toolkit.stages import REGISTRIES
from toolkit.training.config import LoftrTraining, MixvprTraining

PAGE = "settings.md"
_SLOTS = SLOTS | REARRANGE_SLOTS
_BOUNDS = {"ge": "≥", "gt": ">", "le": "≤", "lt": "<", "multiple_of": "multiple of"}

_PARTS: dict[str, tuple[str, type[BaseModel]]] = {
    "An experiment's file": (
        "YAML; `toolkit list experiments` says where the shipped ones lie.",
        Experiment,
    ),
    "An entry of `cells`": ("A named cell of an experiment.", CellSpec),
    "A named value of `sweep`": ("A value that tables call by a name.", NamedValue),
    "dataset": (
        "The scenes; `--set dataset.SETTING=VALUE`, for `toolkit dataset build` `--set SETTING=VALUE`. "
        "For captures that are there, `path` and, if not all are wanted, `scenes` stand here instead.",
        TabletopConfig,
    ),
    "pipeline": ("Sec. Method A; on the command line `--set pipeline.SETTING=VALUE`.", PipelineChoice),
    "rearrange": ("Sec. Method B; on the command line `--set rearrange.SETTING=VALUE`.", RearrangeChoice),
    "train loftr": ("`toolkit train loftr --set SETTING=VALUE`.", LoftrTraining),
    "train mixvpr": ("`toolkit train mixvpr --set SETTING=VALUE`.", MixvprTraining),
    "robot.yaml": ("A robot's folder: `--set rearrange.executor.robot=FOLDER`.", RobotFile),
}
"""Heading -> where it is written, and the model that checks it."""


def settings_page() -> str:
    """Markdown of the page.

    Raises:
        ToolkitError: an implementation does not import.
    """
    lines = [
        "# Every setting",
        "",
        "As the models that check them had them when this site was built. `toolkit show dataset`, `show pipeline`,"
        " `show rearrange` and `show STAGE NAME` print the same.",
    ]
    for heading, (where, model) in _PARTS.items():
        lines += ["", f"## {heading}", "", where, "", *settings_table(model)]
    for registry in REGISTRIES.values():
        lines += [
            "",
            f"## {registry.stage}",
            "",
            f"What each [{registry.stage}](stages/{registry_page(registry)}) can be set to.",
        ]
        lines += _implementations(registry)
    for registry, command in ((IMPORTERS, "import"), (EXPORTERS, "export")):
        of = "toolkit capture import" if command == "import" else "toolkit export"
        lines += ["", f"## {command}", "", f"`{of} KIND ... --set SETTING=VALUE`."]
        lines += _implementations(registry)
    return "\n".join(lines) + "\n"


def registry_page(registry: Registry[Any]) -> str:
    """A stage's page. Plural, as the entry-point group: there is a stage called `index`."""
    return f"{registry.group.removeprefix('toolkit.')}.md"


def _implementations(registry: Registry[Any]) -> list[str]:
    lines: list[str] = []
    for entry in registry.entries():
        config = registry.get(entry.name).Config
        if entry.origin == "toolkit" and config.model_fields:
            lines += ["", f"### {registry.stage} {entry.name}", "", *settings_table(config)]
    return lines


def in_cell(text: str) -> str:
    """Text that does not end a table's cell."""
    return text.replace("|", "\\|")


def settings_table(config: type[BaseModel]) -> list[str]:
    """The lines of a table: every setting with type, default and meaning; groups are opened."""
    rows = [
        f"| `{key}` | {in_cell(_type(info))} | {_default(info)} | {_meaning(key, info)} |"
        for key, info in _fields(config)
    ]
    head = ["| setting | type | default | meaning |", "| --- | --- | --- | --- |"]
    return [*head, *rows] if rows else ["It has no settings."]


def _fields(config: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, FieldInfo]]:
    """Settings by dotted key; groups are opened."""
    for key, info in config.model_fields.items():
        if isinstance(info.annotation, type) and issubclass(info.annotation, BaseModel) and _is_group(info.annotation):
            yield from _fields(info.annotation, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", info


def _is_group(model: type[BaseModel]) -> bool:
    """Whether a model is settings that belong together, and no choice of an implementation."""
    return not issubclass(model, StageChoice)


def _meaning(key: str, info: FieldInfo) -> str:
    # A type's own description is of a part of the annotation where the setting may also be left out.
    metadata = [m for part in get_args(info.annotation) for m in getattr(part, "__metadata__", ())]
    for described in (info, *metadata):
        if isinstance(described, FieldInfo) and described.description:
            return in_cell(described.description)
    stage = _SLOTS.get(key) if info.annotation is StageChoice else None
    return f"Fills this slot: see [{stage}](stages/{registry_page(REGISTRIES[stage])})." if stage else ""


def _type(info: FieldInfo) -> str:
    bounds = [f"{sign} {getattr(m, at)}" for m in info.metadata for at, sign in _BOUNDS.items() if hasattr(m, at)]
    return ", ".join([_type_name(info.annotation), *bounds])


def _type_name(kind: Any) -> str:
    if get_origin(kind) is Literal:
        return " or ".join(f"`{value}`" for value in get_args(kind))
    if kind is type(None):
        return "none"
    if get_origin(kind) is Annotated:
        return _type_name(get_args(kind)[0])
    if kind is Any:
        return "any value"
    if get_origin(kind) is dict or kind is dict:
        return "mapping"
    if get_origin(kind) is list or get_args(kind)[1:] == (...,):
        return f"list of {_type_name(get_args(kind)[0])}"
    parts = get_args(kind)
    if parts and get_origin(kind) is not tuple:
        return " or ".join(_type_name(part) for part in parts)
    if parts:
        return f"({', '.join(_type_name(part) for part in parts)})"
    names = {"Path": "file or folder", "str": "text", "int": "integer", "float": "number", "bool": "yes or no"}
    model = "mapping" if issubclass(kind, BaseModel) else kind.__name__
    return {**names, "StageChoice": "name, or name and settings"}.get(kind.__name__, model)


def _default(info: FieldInfo) -> str:
    if info.is_required():
        return "required"
    if info.default == () or get_origin(info.default_factory) in (dict, list):
        return "empty"
    # What a factory gives depends on the machine the site is built on.
    if info.default_factory:
        return "the machine's best"
    default = info.default.name if isinstance(info.default, StageChoice) else info.default
    return "none" if default is None else in_cell(f"`{default}`" if default != "" else "empty")
