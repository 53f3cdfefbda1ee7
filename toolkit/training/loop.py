"""The loop around every training: seeded, resumable to the bit, averaged, and written down."""

from __future__ import annotations

import copy
import csv
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Generic, Protocol, Self, TypeVar

import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset

from toolkit.errors import ToolkitError
from toolkit.files import new_file
from toolkit.progress import Progress
from toolkit.training.config import LoopConfig
from toolkit.training.curves import draw_curves


class Batch(Protocol):
    """The samples of a step, as tensors."""

    def to(self, device: torch.device) -> Self:
        """The same on a device."""
        ...


BatchT = TypeVar("BatchT", bound=Batch)

CHECKPOINT, CURVES = "checkpoint.pt", "curves.csv"
_LOG_EVERY = 25


class Task(Protocol[BatchT]):
    """What is trained."""

    def build(self) -> nn.Module:
        """The network with its starting weights, on the processor; torch is seeded."""
        ...

    def rates(self, model: nn.Module) -> list[tuple[list[nn.Parameter], float]]:
        """All parameters in groups, with the part of the learning rate each group is trained at."""
        ...

    def batch(self, step: int) -> BatchT:
        """The samples of a step, which depend on the seed and the step alone."""
        ...

    def loss(self, model: nn.Module, batch: BatchT) -> tuple[Tensor, dict[str, float]]:
        """The loss of a batch, and its parts to write down."""
        ...

    def evaluate(self, model: nn.Module, device: torch.device) -> dict[str, float]:
        """Figures on what is not trained on; the model is in evaluation mode, on that device."""
        ...


class _Steps(Dataset[BatchT]):
    """A task's batches by step, from the first that is left."""

    def __init__(self, task: Task[BatchT], steps: range) -> None:
        self._task, self._steps = task, steps

    def __len__(self) -> int:
        return len(self._steps)

    def __getitem__(self, index: int) -> BatchT:
        return self._task.batch(self._steps[index])


class Trainer(Generic[BatchT]):
    """Trains a task in a folder.

    Args:
        task: what to train.
        config: how.
        out: folder for checkpoint, curves and pictures.
        identity: everything that decides the result but `loop.steps`; a checkpoint of another one is refused.
        progress: shows a bar.
        device: what the network is trained on. The same seed gives the same bytes on a processor only.
        workers: processes that draw batches ahead; with 0, a batch is drawn when it is needed.
    """

    def __init__(
        self,
        task: Task[BatchT],
        config: LoopConfig,
        out: Path,
        identity: Mapping[str, Any],
        progress: Progress,
        device: str = "cpu",
        workers: int = 0,
    ) -> None:
        self.task, self.config, self.out, self.identity, self.progress = task, config, out, identity, progress
        self._device, self._workers = torch.device(device), workers
        # Sums over indices are added in any order otherwise; on CUDA not every layer has such an algorithm.
        torch.use_deterministic_algorithms(self._device.type == "cpu")
        torch.utils.deterministic.fill_uninitialized_memory = False  # pyright: ignore[reportAttributeAccessIssue]
        torch.manual_seed(config.seed)
        self.model = task.build().to(self._device, memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
        self.average = copy.deepcopy(self.model).eval().requires_grad_(False)
        groups = [{"params": parameters, "rate": rate} for parameters, rate in task.rates(self.model)]
        self.optimizer = torch.optim.AdamW(groups, lr=config.learning_rate, weight_decay=config.weight_decay)
        self.step, self.seconds = 0, 0.0
        self.figures: dict[str, float] = {}

    def resume(self) -> None:
        """Go on from the folder's checkpoint.

        Raises:
            ToolkitError: there is none, or it is of other settings.
        """
        path = self.out / CHECKPOINT
        if not path.is_file():
            raise ToolkitError(f"there is no checkpoint '{path}' to resume; leave out --resume to start")
        state = torch.load(path, map_location=self._device, weights_only=True)
        if state["identity"] != self.identity:
            changed = [k for k in self.identity if state["identity"].get(k) != self.identity[k]]
            raise ToolkitError(
                f"'{path}' is of a training with other settings ({', '.join(changed)}); use another --out"
            )
        self.model.load_state_dict(state["model"])
        self.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.seconds = state["step"], state["seconds"]
        _truncate(self.out / CURVES, self.step)

    def run(self) -> nn.Module:
        """Train to the last step; returns the averaged network in evaluation mode. `figures` are its last ones."""
        self.out.mkdir(parents=True, exist_ok=True)
        c = self.config
        with self.progress.step("Training", c.steps) as advance:
            advance(self.step)
            started = time.monotonic() - self.seconds
            sums: dict[str, float] = {}
            steps = _Steps(self.task, range(self.step, c.steps))
            for batch in DataLoader(steps, batch_size=None, num_workers=self._workers):
                parts = self._update(batch.to(self._device))
                self.step += 1
                self.seconds = time.monotonic() - started
                for name, value in parts.items():
                    sums[name] = sums.get(name, 0.0) + value
                if self.step % _LOG_EVERY == 0 or self.step == c.steps:
                    count = self.step % _LOG_EVERY or _LOG_EVERY
                    row = {name: value / count for name, value in sums.items()}
                    sums = {}
                    if self.step % c.evaluate_every == 0 or self.step == c.steps:
                        self.figures = self._evaluate()
                        row |= self.figures
                    self._record(row)
                if self.step % c.checkpoint_every == 0 or self.step == c.steps:
                    self._save()
                advance(1)
        self.figures = self.figures or self._evaluate()
        return self.average

    def _update(self, batch: BatchT) -> dict[str, float]:
        for group in self.optimizer.param_groups:
            group["lr"] = group["rate"] * self.config.learning_rate * learning_rate_factor(self.config, self.step)
        self.model.train()
        with torch.autocast(self._device.type, torch.bfloat16, enabled=self.config.bf16):
            loss, parts = self.task.loss(self.model, batch)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        self.optimizer.step()
        self._follow()
        return {"loss": float(loss.detach()), **parts}

    @torch.no_grad()
    def _follow(self) -> None:
        """Move the average towards the weights; faster at first, so that the start is forgotten."""
        keep = min(self.config.average, (1 + self.step) / (10 + self.step))
        for slow, fast in zip(self.average.state_dict().values(), self.model.state_dict().values(), strict=True):
            if slow.is_floating_point():
                slow.lerp_(fast, 1 - keep)
            else:
                slow.copy_(fast)

    def _evaluate(self) -> dict[str, float]:
        with torch.inference_mode():
            return self.task.evaluate(self.average, self._device)

    def _record(self, row: Mapping[str, float]) -> None:
        path = self.out / CURVES
        new = not path.is_file()
        with path.open("a", newline="") as file:
            writer = csv.writer(file)
            if new:
                writer.writerow(["step", "seconds", "name", "value"])
            writer.writerows([self.step, round(self.seconds, 1), name, f"{v:.6g}"] for name, v in row.items())

    def _save(self) -> None:
        state = {
            "identity": dict(self.identity),
            "model": self.model.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "step": self.step,
            "seconds": self.seconds,
        }
        with new_file(self.out / CHECKPOINT) as temporary:
            torch.save(state, temporary)
        draw_curves(self.out / CURVES)


def learning_rate_factor(config: LoopConfig, step: int) -> float:
    """Linear warm-up, constant, then linear to zero over the last part."""
    rising = (step + 1) / config.warmup if config.warmup else 1.0
    falling = (config.steps - step) / (config.decay * config.steps) if config.decay else 1.0
    return min(1.0, rising, falling)


def _truncate(path: Path, step: int) -> None:
    """Drop what was written after the checkpoint."""
    if path.is_file():
        head, *lines = path.read_text().splitlines(keepends=True)
        path.write_text(head + "".join(line for line in lines if int(line.partition(",")[0]) <= step))
