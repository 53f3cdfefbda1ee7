"""Runs in TensorBoard: `tensorboard --logdir runs` shows all of them beside each other."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import yaml

from toolkit.errors import ToolkitError
from toolkit.harness.hooks.hook import RunHook, Start
from toolkit.registry import Plugin
from toolkit.results.folder import TABLE
from toolkit.results.rows import ObjectRow


class TensorBoard(Plugin, RunHook):
    """RUN/tensorboard: objects right in each cell as rows come in, every figure of the summary, and its tables."""

    stage = "hook"
    name = "tensorboard"

    def check_ready(self) -> None:
        """Raise ToolkitError unless tensorboard is installed."""
        if find_spec("tensorboard") is None:
            raise ToolkitError(
                "the hook 'tensorboard' needs TensorBoard; run: pip install 'rearrange-toolkit[tensorboard]'"
            )

    def begin(self, start: Start) -> None:
        from torch.utils.tensorboard.writer import SummaryWriter

        self._writer = SummaryWriter(str(start.run / "tensorboard"))
        self._right: dict[str, list[bool]] = defaultdict(list)
        self._writer.add_text("settings", f"```yaml\n{yaml.safe_dump(dict(start.settings), sort_keys=False)}```")

    def rows(self, rows: Sequence[ObjectRow]) -> None:
        for row in rows:
            self._right[row.cell].append(bool(getattr(row, "success_sym", False)))
        for cell in dict.fromkeys(row.cell for row in rows):
            right = self._right[cell]
            self._writer.add_scalar(f"objects right/{cell}", sum(right) / len(right), len(right))

    def table(self, lines: Sequence[Mapping[str, Any]]) -> None:
        for line in lines:
            for figure, value in line.items():
                if isinstance(value, (int, float)) and math.isfinite(value):
                    self._writer.add_scalar(f"{figure}/{line['cell']}", value)

    def end(self, run: Path | None) -> None:
        if run is not None and (run / TABLE).is_file():
            self._writer.add_text("tables", (run / TABLE).read_text())
        self._writer.close()
