"""What every backend runs in a worker process."""

from __future__ import annotations

import importlib
import threading
from collections.abc import Callable
from typing import Any, TypeVar

from toolkit.errors import ToolkitError

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")

LOSSES = 3
"""How often a task is started again when its worker is lost; after that, the task itself kills the workers."""

_one_at_a_time = threading.Lock()


def nothing() -> None:
    """Prepare nothing."""


def call(prepare: Callable[[], None], function: Callable[[TaskT], ResultT], task: TaskT) -> ResultT:
    """Make this process ready and do one task.

    Stages keep state (an index, a meter), so that one task is done at a time even where a cluster's worker has threads.
    """
    with _one_at_a_time:
        prepare()
        return function(task)


def optional(module: str, backend: str) -> Any:
    """Import a module that an optional extra installs.

    Raises:
        ToolkitError: the extra is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ToolkitError(f"--backend {backend} needs {module}: pip install 'rearrange-toolkit[{backend}]'") from error


def gave_up() -> ToolkitError:
    """What is said when workers are lost again and again."""
    return ToolkitError(
        f"workers were lost {LOSSES + 1} times on the same work, most likely for want of memory; "
        "finished rows are kept, and --resume goes on with fewer --workers"
    )
