"""What a check is, and how the checks of a stage are run over one plugin."""

from __future__ import annotations

import importlib
import random
import resource
import sys
import time
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, TypeVar

import numpy as np

from toolkit.errors import ToolkitError
from toolkit.registry import Plugin, validated

STAGE_CHECKS: dict[str, str] = {
    "registration": "toolkit.plugin_kit.conformance.registration",
    "segmenter": "toolkit.plugin_kit.conformance.segmenter",
    "associator": "toolkit.plugin_kit.conformance.associator",
    "explainer": "toolkit.plugin_kit.conformance.explainer",
    "descriptor": "toolkit.plugin_kit.conformance.descriptor",
    "index": "toolkit.plugin_kit.conformance.index",
    "retriever": "toolkit.plugin_kit.conformance.retriever",
    "matcher": "toolkit.plugin_kit.conformance.matcher",
    "pnp": "toolkit.plugin_kit.conformance.pnp",
    "refiner": "toolkit.plugin_kit.conformance.refiner",
    "planner": "toolkit.plugin_kit.conformance.planner",
    "grasp": "toolkit.plugin_kit.conformance.grasp",
    "motion": "toolkit.plugin_kit.conformance.motion",
    "executor": "toolkit.plugin_kit.conformance.executor",
}
"""Stage -> the module whose CHECKS its implementations must pass."""


class ConformanceError(Exception):
    """What a plugin does that its stage does not allow, in one sentence."""


def require(condition: object, sentence: str) -> None:
    """Raise ConformanceError with `sentence` unless `condition` holds."""
    if not condition:
        raise ConformanceError(sentence)


@dataclass(frozen=True)
class Subject:
    """The plugin under test.

    Attributes:
        plugin: its class.
        settings: settings that differ from its defaults.
    """

    plugin: type[Plugin]
    settings: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def make(self) -> Any:
        """A new instance, which has seen nothing yet."""
        what = f"{self.plugin.stage} '{self.plugin.name}'"
        return self.plugin(validated(self.plugin.Config, dict(self.settings), what))


SubjectT = TypeVar("SubjectT")

Check = Callable[[Subject], str | None]
"""Raises ConformanceError, or returns a remark or nothing; its docstring says what is asked of the plugin."""


@dataclass(frozen=True)
class Outcome:
    """What one check found.

    Attributes:
        check: its name, in words.
        passed: whether the plugin conforms.
        note: what is wrong, in a sentence; or a remark.
        seconds: the check's time, which includes making the plugin.
        grown_mb: by how much the process's largest memory grew meanwhile, MB.
    """

    check: str
    passed: bool
    note: str
    seconds: float
    grown_mb: float


def checks_of(stage: str) -> list[Check]:
    """All checks of a stage, the general ones first.

    Raises:
        ToolkitError: there is no such stage.
    """
    if stage not in STAGE_CHECKS:
        raise ToolkitError(f"unknown stage '{stage}'; choose from: {', '.join(STAGE_CHECKS)}")
    modules = ("toolkit.plugin_kit.conformance.general", STAGE_CHECKS[stage])
    return [check for module in modules for check in importlib.import_module(module).CHECKS]


def check_plugin(plugin: type[Plugin], settings: Mapping[str, Any] | None = None) -> list[Outcome]:
    """Run every check of a plugin's stage over it; one that raises has failed that check, and the others go on.

    Args:
        plugin: its class.
        settings: settings that differ from its defaults.

    Raises:
        ToolkitError: the settings do not fit, or the plugin says that it lacks something (a checkpoint, a device).
    """
    subject = Subject(plugin, settings or {})
    checks = checks_of(plugin.stage)
    make_ready(subject)
    return [run_check(check, subject) for check in checks]


def make_ready(subject: Subject) -> None:
    """Let the plugin say by ToolkitError that it lacks something; whatever else it raises, the checks will find."""
    try:
        subject.make().check_ready()
    except ToolkitError:
        raise
    except Exception:
        return


def run_check(check: Callable[[SubjectT], str | None], subject: SubjectT) -> Outcome:
    """Run one check; nothing that its subject raises gets out."""
    start, memory = time.perf_counter(), _peak_mb()
    try:
        passed, note = True, check(subject) or ""
    except ConformanceError as error:
        passed, note = False, str(error)
    except Exception as error:
        passed, note = False, f"raises {type(error).__name__}: {_first_line(error)} ({_where(error)})"
    seconds = time.perf_counter() - start
    return Outcome(title(check), passed, note, seconds, max(0.0, _peak_mb() - memory))


def title(check: Callable[..., object]) -> str:
    """A check's name in words."""
    return check.__name__.replace("_", " ")


def require_same_twice(work: Callable[[], object], what: str) -> None:
    """Require that `work` gives the same bytes twice, whatever state the global random generators are in."""
    answers: list[object] = []
    for state in (1, 2):
        random.seed(state)
        np.random.seed(state)
        if "torch" in sys.modules:
            sys.modules["torch"].manual_seed(state)
        answers.append(work())
    require(same(*answers), f"{what} differs between two runs on the same input")


def same(a: Any, b: Any) -> bool:
    """Say whether two values are equal to the byte: arrays, dataclasses, mappings and sequences of them."""
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        x, y = np.asarray(a), np.asarray(b)
        return x.dtype == y.dtype and x.shape == y.shape and x.tobytes() == y.tobytes()
    if type(a) is not type(b):
        return False
    if is_dataclass(a) and not isinstance(a, type):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, Sequence) and not isinstance(a, str | bytes):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(a, b, strict=True))
    return bool(a == b)


def require_array(value: object, shape: tuple[int | None, ...], dtype: object, what: str) -> np.ndarray:
    """Require a NumPy array of a shape (None: any length) and dtype, and return it."""
    require(isinstance(value, np.ndarray), f"{what} must be a NumPy array, got {type(value).__name__}")
    assert isinstance(value, np.ndarray)
    fits = value.ndim == len(shape) and all(want in (None, got) for want, got in zip(shape, value.shape, strict=True))
    wanted = "x".join("N" if side is None else str(side) for side in shape)
    require(fits, f"{what} must have shape {wanted}, got {'x'.join(map(str, value.shape))}")
    require(value.dtype == dtype, f"{what} must be {np.dtype(dtype).name}, got {value.dtype}")  # pyright: ignore[reportArgumentType,reportCallIssue]
    return value


def _peak_mb() -> float:
    unit = 1 if sys.platform == "darwin" else 1024  # macOS counts bytes, Linux KiB
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]


def _where(error: Exception) -> str:
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{last.filename}, line {last.lineno}"
