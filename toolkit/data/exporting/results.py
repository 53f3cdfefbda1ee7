"""Folders that `estimate` and `evaluate` wrote, as what exporters are given."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from toolkit.data.clouds import read_cloud
from toolkit.errors import ToolkitError
from toolkit.results.poses import POSES, Instance, Poses, read_poses
from toolkit.types import Float


@dataclass(frozen=True)
class Result:
    """What is known of one capture.

    Attributes:
        folder: where poses.json lies, with what it names.
        poses: its content.
    """

    folder: Path
    poses: Poses

    def cloud(self, instance: Instance) -> tuple[Float, Float]:
        """(N, 3) float32 world points of an instance and their (N, 3) colours; raises ToolkitError as `read_cloud`."""
        return read_cloud(self.folder / instance.model)


class Exporter(Protocol):
    """Writes one kind of file."""

    @abstractmethod
    def write(self, results: Sequence[Result], out: Path) -> list[str]:
        """Write results; returns what was left out, in sentences.

        Args:
            results: of one capture or more.
            out: the file, or the folder where there are several files.

        Raises:
            ToolkitError: they lack something, or a setting does not fit them.
        """
        ...


def read_results(folder: Path) -> list[Result]:
    """The result of `estimate`, or of every capture that `evaluate` was given, by name.

    Raises:
        ToolkitError: there is no poses.json, or one cannot be read.
    """
    folders = [folder] if (folder / POSES).is_file() else sorted(path.parent for path in folder.glob(f"*/{POSES}"))
    if not folders:
        raise ToolkitError(
            f"'{folder}' holds no {POSES}; it is where `toolkit estimate` or `evaluate` wrote to (--out)"
        )
    results = [Result(path, read_poses(path / POSES)) for path in folders]
    old = next((result for result in results if not result.poses.instances and _has_motion(result.poses)), None)
    if old is not None:
        raise ToolkitError(f"'{old.folder / POSES}' tells nothing of instances, as it is of schema 1; estimate again")
    return results


def one_file_each(results: Sequence[Result], out: Path, suffix: str) -> list[tuple[Result, Path]]:
    """Where every result goes: `out`, or OUT/CAPTURE of several."""
    if len(results) == 1:
        return [(results[0], out)]
    return [(result, out / f"{result.folder.name}{suffix}") for result in results]


def _has_motion(poses: Poses) -> bool:
    return any(entry.T_goal_current is not None for entry in poses.objects)
