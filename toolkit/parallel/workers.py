"""Workers by name of their backend."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol, TypeVar

from toolkit.errors import ToolkitError, suggest
from toolkit.parallel.call import nothing

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")

BACKENDS = ("loky", "dask", "ray")


class Workers(Protocol):
    """Processes that share the work."""

    def map(self, function: Callable[[TaskT], ResultT], tasks: Sequence[TaskT]) -> Iterator[ResultT]:
        """Call a module's function with every task; results come in the order in which they get done.

        A worker that is lost loses nothing else: its tasks are done again.

        Raises:
            ToolkitError: the function raised it, or workers are lost again and again.
        """
        ...


class Here:
    """Stands in for workers: the work is done in this process."""

    def map(self, function: Callable[[TaskT], ResultT], tasks: Sequence[TaskT]) -> Iterator[ResultT]:
        """As `Workers.map`, in the order of the tasks."""
        return (function(task) for task in tasks)


@contextmanager
def open_workers(
    count: int,
    backend: str = "loky",
    address: str | None = None,
    prepare: Callable[[], None] = nothing,
    say: Callable[[str], None] | None = None,
) -> Generator[Workers]:
    """Start workers, or go to those of a cluster.

    Args:
        count: processes on this machine; a cluster at an address has its own.
        backend: one of BACKENDS. `loky` starts processes here; `dask` and `ray` start a cluster here, or use one.
        address: where a cluster answers.
        prepare: called in a worker before every task; it is sent there, and does its work once per process.
        say: called with what a user should know, such as that a worker was lost.

    Raises:
        ToolkitError: no such backend, its extra is not installed, or nothing answers at the address.
    """
    if backend not in BACKENDS:
        raise ToolkitError(f"unknown backend '{backend}'{suggest(backend, list(BACKENDS))}")
    if backend == "dask":
        from toolkit.parallel.dask import dask_workers

        with dask_workers(count, address, prepare) as workers:
            yield workers
    elif backend == "ray":
        from toolkit.parallel.ray import ray_workers

        with ray_workers(count, address, prepare) as workers:
            yield workers
    elif address is not None:
        raise ToolkitError("--address goes with --backend dask or ray; loky works on this machine only")
    elif count == 1:
        yield Here()
    else:
        from toolkit.parallel.processes import process_workers

        with process_workers(count, prepare, say or (lambda _: None)) as workers:
            yield workers
