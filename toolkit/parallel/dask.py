"""Workers of a dask cluster.

Not through joblib's dask backend: it waits for ever for a task whose workers keep dying (joblib 1.6).
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from toolkit.errors import ToolkitError
from toolkit.parallel.call import call, gave_up, optional
from toolkit.parallel.interrupts import without_interrupts

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")

_PATIENCE_S = 30
"""How long a scheduler, and then its first worker, is waited for."""

_ALONE_S = 120
"""How long a scheduler on this machine may be without workers."""


@contextmanager
def dask_workers(count: int, address: str | None, prepare: Callable[[], None]) -> Generator[DaskWorkers]:
    """The workers of the scheduler at `address`, or `count` processes here.

    Raises:
        ToolkitError: dask is not installed, or no scheduler with workers answers.
    """
    distributed = optional("distributed", "dask")
    where = f"the dask scheduler at '{address}'" if address else "the dask cluster on this machine"
    # What dask says of lost workers and closed connections is said by this package, or is nothing to worry about.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    with ExitStack() as stack:
        try:
            with without_interrupts():
                scheduler = address or stack.enter_context(_local_cluster(distributed, count))
                client = stack.enter_context(distributed.Client(scheduler, timeout=_PATIENCE_S))
        except (OSError, ValueError) as error:
            raise ToolkitError(f"{where} does not answer: {error}") from error
        try:
            client.wait_for_workers(1, timeout=_PATIENCE_S)
        except TimeoutError as error:
            raise ToolkitError(f"{where} has no workers; start some with `dask worker ADDRESS`") from error
        yield DaskWorkers(client, where, prepare)


def _local_cluster(distributed: Any, count: int) -> Any:
    """As many processes as without dask, without limits of their own."""
    # A worker that cannot be started again, on a machine that has too much to do, is never tried again.
    with optional("dask", "dask").config.set({"distributed.scheduler.no-workers-timeout": f"{_ALONE_S} s"}):
        return distributed.LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            memory_limit=0,
            dashboard_address=":0",  # any port: without one, dask takes 8787 and warns where another cluster has it
            silence_logs=logging.CRITICAL,
        )


@dataclass(frozen=True)
class DaskWorkers:
    """Workers of a scheduler, which gives the tasks of a lost worker to others."""

    client: Any
    where: str
    prepare: Callable[[], None]

    def map(self, function: Callable[[TaskT], ResultT], tasks: Sequence[TaskT]) -> Iterator[ResultT]:
        """As `Workers.map`."""
        distributed = optional("distributed", "dask")
        futures = self.client.map(partial(call, self.prepare, function), tasks, pure=False, key="toolkit")
        try:
            for future in distributed.as_completed(futures):
                yield future.result()
        except distributed.KilledWorker as error:
            raise gave_up() from error
        except (CancelledError, distributed.scheduler.NoWorkerError) as error:
            raise ToolkitError(f"{self.where} was lost; finished rows are kept, and --resume goes on") from error
        finally:
            self.client.cancel(futures)
