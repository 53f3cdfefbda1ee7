"""YAML -> validated experiment -> cells. A cell is one complete setting; a sweep is the product of its lists."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from toolkit.data.scene import TabletopConfig
from toolkit.data.source import resolve_settings
from toolkit.errors import ToolkitError, suggest
from toolkit.harness.hooks import HOOKS
from toolkit.perception.pipeline import PipelineSettings
from toolkit.rearrangement.episode import EpisodeSettings
from toolkit.registry import Registry, StageChoice, load_plugin_file, validated
from toolkit.results.comparisons import is_called
from toolkit.settings import assign, keys_of, read_settings, shipped_settings
from toolkit.slots import REARRANGE_SLOTS, SLOTS
from toolkit.stages import REGISTRIES, register_module

_ALL_SLOTS = SLOTS | REARRANGE_SLOTS


class PipelineChoice(PipelineSettings):
    """The `pipeline:` part of an experiment: one choice per slot, and the pipeline's own settings."""

    registration: StageChoice = StageChoice(name="none")
    segmenter: StageChoice
    goal_segmenter: StageChoice
    associator: StageChoice
    explainer: StageChoice = StageChoice(name="none")
    descriptor: StageChoice
    index: StageChoice
    retriever: StageChoice
    matcher: StageChoice
    pnp: StageChoice
    refiner: StageChoice = StageChoice(name="none")


class RearrangeChoice(EpisodeSettings):
    """The `rearrange:` part of an experiment: planner and executor, and the rearrangement's own settings."""

    planner: StageChoice
    executor: StageChoice


class CellSpec(BaseModel):
    """A named cell of an experiment that is not a product: what it changes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(description="What tables call it.")
    set: dict[str, Any] = Field(default_factory=dict[str, Any], description="Changed values by path.")


class NamedValue(BaseModel):
    """A value of a sweep, and what people call it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(description="What tables call it.")
    value: Any = Field(description="What is set.")


class Experiment(BaseModel):
    """A validated experiment file."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(pattern=r"^[A-Za-z0-9_.-]+$", description="Of its runs' folder.")
    title: str = Field("", description="Of its reports; the name when left out.")
    description: str = Field("", description="What is compared, in a sentence.")
    reference: str = Field(
        "",
        description="The cell that all others are compared with, by its name or that of its entry in `cells`; the "
        "first one of the same scenes when left out.",
    )
    seed: int = Field(0, ge=0, description="Seed of scenes and stages.")
    plugins: tuple[Path, ...] = Field((), description="Plugin files that are not installed, from the YAML's folder.")
    dataset: dict[str, Any] = Field(description="The scenes.")
    pipeline: dict[str, Any] = Field(description="What estimates motions.")
    rearrange: dict[str, Any] | None = Field(None, description="What moves objects, for `toolkit rearrange`.")
    cells: tuple[CellSpec, ...] = Field(
        (), description="Settings that are compared, by name; each is run with every sweep."
    )
    sweep: dict[str, list[Annotated[NamedValue | Any, Field(union_mode="left_to_right")]]] = Field(
        default_factory=dict[str, list[Any]], description="Values by path; {name: ..., value: ...} names one."
    )


PARTS: dict[str, type[BaseModel]] = {
    "dataset": TabletopConfig,
    "pipeline": PipelineChoice,
    "rearrange": RearrangeChoice,
}
"""The settings of each part of an experiment."""


@dataclass(frozen=True)
class Cell:
    """One complete setting of an experiment.

    Attributes:
        name: what sets it apart, e.g. `multi-view` or `matcher=sift, views=1`; the experiment's when nothing is swept.
        settings: the swept values by path.
        seed: the experiment's seed.
        dataset: the `dataset:` part, with the sweep applied and every default written out.
        pipeline: the `pipeline:` part, checked.
        rearrange: the `rearrange:` part, checked; None where the experiment has none.
    """

    name: str
    settings: dict[str, Any]
    seed: int
    dataset: dict[str, Any]
    pipeline: PipelineChoice
    rearrange: RearrangeChoice | None = None

    def resolved(self) -> dict[str, Any]:
        """Everything that decides this cell's results, with every default written out."""
        resolved = {
            "cell": self.name,
            "settings": self.settings,
            "seed": self.seed,
            "dataset": self.dataset,
            "pipeline": _resolved(self.pipeline, SLOTS),
        }
        if self.rearrange is not None:
            resolved["rearrange"] = _resolved(self.rearrange, REARRANGE_SLOTS)
        return resolved

    @classmethod
    def read(cls, resolved: Mapping[str, Any]) -> Cell:
        """The cell that `resolved` gave.

        Raises:
            ToolkitError: a setting does not fit.
            KeyError: a part is missing.
        """
        parts = (resolved["cell"], resolved["settings"], resolved["seed"], resolved["dataset"])
        pipeline = validated(PipelineChoice, resolved["pipeline"], "pipeline")
        rearrange = resolved.get("rearrange")
        return cls(*parts, pipeline, rearrange and validated(RearrangeChoice, rearrange, "rearrange"))


def _resolved(part: PipelineChoice | RearrangeChoice, slots: Mapping[str, str]) -> dict[str, Any]:
    """A part of an experiment with every default of its stages written out."""
    resolved = part.model_dump(mode="json")
    for slot, stage in slots.items():
        resolved[slot] = REGISTRIES[stage].choose(getattr(part, slot)).model_dump(mode="json")
    return resolved


def load_experiment(
    name_or_path: str, overrides: Mapping[str, Sequence[Any]] | None = None, *, rearranges: bool = False
) -> Experiment:
    """Read an experiment by shipped name or by path, and apply command-line overrides.

    Args:
        name_or_path: `quick`, or `my/experiment.yaml`.
        overrides: path -> values; one value replaces, several sweep. Such a sweep takes the place of the file's own,
            whose paths stay at their first value.
        rearranges: an experiment without a `rearrange:` part gets one with every default.

    Raises:
        ToolkitError: no such experiment, YAML that does not parse (file and line), unknown keys or wrong values.
    """
    path = Path(name_or_path)
    if path.suffix not in {".yaml", ".yml"}:
        shipped = shipped_settings()
        if name_or_path not in shipped:
            raise ToolkitError(f"unknown experiment '{name_or_path}'{suggest(name_or_path, list(shipped))}")
        path = shipped[name_or_path]
    data = read_settings(path, "experiment", "name, dataset and pipeline")
    what = f"experiment '{path}'"
    read = validated(Experiment, data, what)  # what is wrong in the file is not blamed on an override
    if rearranges:
        data.setdefault("rearrange", {})
    if isinstance(data.get("rearrange"), dict):
        data["rearrange"] = {"planner": "optimal", "executor": "kinematic", **data["rearrange"]}
    data |= _said(read, overrides or {})
    if any(len(values) > 1 for values in (overrides or {}).values()):
        data.pop("sweep", None)
        for key, values in read.sweep.items():
            if values:
                assign(data, key, _value(values[0]))
    for key, values in (overrides or {}).items():
        _require_part(key)
        _override(data, key, list(values))
    experiment = validated(Experiment, data, what)
    plugins = tuple((path.parent / plugin).absolute() for plugin in experiment.plugins)
    for file in plugins:
        register_plugin_file(file)
    return experiment.model_copy(update={"plugins": plugins})


def register_plugin_file(file: Path) -> None:
    """Load a plugin file that is not installed and register its classes.

    Raises:
        ToolkitError: the file is absent, does not import, or holds no plugin.
    """
    if register_module(load_plugin_file(file), str(file), {**REGISTRIES, HOOKS.stage: HOOKS}) == 0:
        raise ToolkitError(f"plugin file '{file}' defines no Plugin class with `stage` and `name`")


def expand(experiment: Experiment) -> list[Cell]:
    """The product of the named cells and the sweep, every stage name and setting checked.

    Raises:
        ToolkitError: an unknown path, stage name or setting, or two cells that come out the same.
    """
    bases = experiment.cells or (CellSpec(name=""),)
    paths = list(experiment.sweep)
    cells: list[Cell] = []
    for base in bases:
        for values in itertools.product(*experiment.sweep.values()):
            swept = {path: _value(value) for path, value in zip(paths, values, strict=True)}
            data = copy.deepcopy({"dataset": experiment.dataset, "pipeline": experiment.pipeline})
            if experiment.rearrange is not None:
                data["rearrange"] = copy.deepcopy(experiment.rearrange)
            for path, value in {**base.set, **swept}.items():
                assign(data, path, value)
            parts = [base.name] if base.name else []
            parts += [_label(path, value) for path, value in zip(paths, values, strict=True)]
            name = ", ".join(parts) or experiment.name
            pipeline = validated(PipelineChoice, data["pipeline"], "pipeline")
            settings = {"cell": base.name, **base.set, **swept} if base.name else swept
            dataset = resolve_settings(data["dataset"], experiment.seed)
            if pipeline.views != "all" and pipeline.views > (frames := dataset.get("views", pipeline.views)):
                raise ToolkitError(
                    f"pipeline.views is {pipeline.views}, but a scene has {frames} frames: dataset.views"
                )
            rearrange = validated(RearrangeChoice, data["rearrange"], "rearrange") if "rearrange" in data else None
            cell = Cell(name, settings, experiment.seed, dataset, pipeline, rearrange)
            cell.resolved()
            cells.append(cell)
    names = [cell.name for cell in cells]
    doubled = next((name for name in names if names.count(name) > 1), None)
    if doubled:
        raise ToolkitError(f"two cells are called '{doubled}'; give every swept value once")
    if experiment.reference and not any(is_called(experiment.reference, c.name, c.settings) for c in cells):
        near = suggest(experiment.reference, names)
        raise ToolkitError(f"reference '{experiment.reference}' is none of the cells{near}")
    return cells


def only_cell(experiment: Experiment) -> Cell:
    """The cell of an experiment that makes one.

    Raises:
        ToolkitError: it makes several, or as `expand`.
    """
    cells = expand(experiment)
    if len(cells) > 1:
        raise ToolkitError(
            f"one setting is run here, but '{experiment.name}' makes {len(cells)}; use `toolkit ablate` to sweep"
        )
    return cells[0]


def episode_settings(rearrange: RearrangeChoice) -> EpisodeSettings:
    """The rearrangement's own settings, without the stage choices."""
    return EpisodeSettings(**{name: getattr(rearrange, name) for name in EpisodeSettings.model_fields})


def own_settings(pipeline: PipelineChoice) -> PipelineSettings:
    """The pipeline's own settings, without the stage choices."""
    return PipelineSettings(**{name: getattr(pipeline, name) for name in PipelineSettings.model_fields})


def create_stage(part: PipelineChoice | RearrangeChoice, slot: str) -> Any:
    """Make the implementation that fills one slot: a `Plugin` that follows the slot's Protocol."""
    choice: StageChoice = getattr(part, slot)
    registry: Registry[Any] = REGISTRIES[_ALL_SLOTS[slot]]
    return registry.create(choice.name, choice.settings)


def _said(experiment: Experiment, overrides: Mapping[str, Sequence[Any]]) -> dict[str, str]:
    """Title and description of an experiment that the command line changes: what it says itself may be true no more."""
    swept = [f"{_short(path)}: {' or '.join(map(str, own))}" for path, own in overrides.items() if len(own) > 1]
    changed = [f"{_short(path)} {own[0]}" for path, own in overrides.items() if len(own) == 1]
    title = experiment.title or experiment.name
    said = [f"With the settings of '{experiment.name}'." if swept else experiment.description]
    said += [f"Changed: {', '.join(changed)}."] if changed else []
    return {"title": "; ".join(swept) or title, "description": " ".join(filter(None, said))}


def _require_part(path: str) -> None:
    """Refuse the path of a setting that lacks the name of its part, and say which that is."""
    first, *_ = keys_of(path)
    homes = [part for part, model in PARTS.items() if first in model.model_fields]
    if homes and first not in Experiment.model_fields:
        raise ToolkitError(f"cannot set '{path}': there is no '{first}'; did you mean '{homes[0]}.{path}'?")


def _override(data: dict[str, Any], path: str, values: list[Any]) -> None:
    """Apply a command-line choice: it replaces what the file set or swept at that path, in every cell."""
    data.setdefault("sweep", {}).pop(path, None)
    for cell in data.get("cells", ()):
        for former in list(cell.get("set", ())):
            if keys_of(former)[: len(keys_of(path))] == keys_of(path):
                del cell["set"][former]
    if len(values) == 1:
        assign(data, path, values[0])
    else:
        data["sweep"][path] = values


def _short(path: str) -> str:
    return ".".join(keys_of(path)).removeprefix("pipeline.").removeprefix("dataset.").removeprefix("rearrange.")


def _value(value: Any) -> Any:
    return value.value if isinstance(value, NamedValue) else value


def _label(path: str, value: Any) -> str:
    if isinstance(value, NamedValue):
        return value.name
    said = "+".join(map(str, value.values())) if isinstance(value, Mapping) else value
    return f"{_short(path)}={said}"
