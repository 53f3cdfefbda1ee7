"""Workers of a ray cluster.

Not through joblib's ray backend: it hands over nothing before everything is done (ray 2.60), and rows shall be
kept as they come.
"""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, TypeVar

from toolkit.errors import ToolkitError
from toolkit.parallel.call import LOSSES, call, gave_up, optional
from toolkit.parallel.interrupts import without_interrupts

TaskT = TypeVar("TaskT")
ResultT = TypeVar("ResultT")

_PATIENCE_S = 10
_STORE_BYTES = 128 * 2**20
"""Shared memory of a cluster on this machine: rows are small."""


@contextmanager
def ray_workers(count: int, address: str | None, prepare: Callable[[], None]) -> Generator[RayWorkers]:
    """The workers of the cluster at `address`, or `count` processes here.

    Raises:
        ToolkitError: ray is not installed, or no cluster answers.
    """
    # Nobody asked for reports to ray's makers.
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    ray = optional("ray", "ray")
    if address is not None:
        _require_answer(address)
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.CRITICAL}
    try:
        with without_interrupts():
            if address is None:
                ray.init(num_cpus=count, object_store_memory=_STORE_BYTES, include_dashboard=False, **quiet)
            else:
                ray.init(address=address, **quiet)
    except (OSError, RuntimeError, ValueError) as error:
        reason = str(error).partition("\n")[0]
        where = f"the ray cluster at '{address}'" if address else "the ray cluster on this machine"
        raise ToolkitError(f"{where} does not answer: {reason}") from error
    try:
        yield RayWorkers(ray, prepare)
    finally:
        ray.shutdown()


def _require_answer(address: str) -> None:
    """Ask the address first, since ray itself waits for minutes where nothing answers."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdecimal():
        raise ToolkitError(f"a ray cluster's address is HOST:PORT or ray://HOST:PORT, got '{address}'")
    try:
        socket.create_connection((host, int(port)), timeout=_PATIENCE_S).close()
    except (OSError, OverflowError) as error:
        raise ToolkitError(f"the ray cluster at '{address}' does not answer: {error}") from error


@dataclass(frozen=True)
class RayWorkers:
    """Processes that ray starts where it has free cores; the tasks of a lost process are done again in others."""

    ray: Any
    prepare: Callable[[], None]

    def map(self, function: Callable[[TaskT], ResultT], tasks: Sequence[TaskT]) -> Iterator[ResultT]:
        """As `Workers.map`."""
        remote = self.ray.remote(num_cpus=1, max_retries=LOSSES)(call)
        pending = [remote.remote(self.prepare, function, task) for task in tasks]
        try:
            while pending:
                (done,), pending = self.ray.wait(pending)
                yield self.ray.get(done)
        except self.ray.exceptions.RayTaskError as error:
            # ray mixes the traceback into the message.
            raise error.cause from error
        except self.ray.exceptions.RayError as error:
            raise gave_up() from error
        finally:
            for reference in pending:
                self.ray.cancel(reference, force=True)
