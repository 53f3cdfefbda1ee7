"""Settings in YAML: the files that travel with the package, reading one, and changing a value by its path."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from toolkit.errors import ToolkitError, suggest
from toolkit.slots import REARRANGE_SLOTS, SLOTS

_SLOTS = SLOTS | REARRANGE_SLOTS


def shipped_settings(folder: str = "") -> dict[str, Path]:
    """YAML files that travel with the package, by name; in a checkout, those of `experiments/`.

    Args:
        folder: a folder in there; the experiments themselves when left out.
    """
    here = Path(__file__).parent
    packaged = here / "experiments"
    root = packaged if packaged.is_dir() else here.parent / "experiments"
    return {path.stem: path for path in sorted((root / folder).glob("*.yaml"))}


def read_settings(path: Path, what: str, parts: str) -> dict[str, Any]:
    """Read a YAML file that holds a mapping.

    Args:
        path: the file.
        what: what it is called in answers, e.g. `experiment`.
        parts: what the mapping is of, in words.

    Raises:
        ToolkitError: it cannot be read, does not parse (file and line), or holds something else.
    """
    try:
        data = yaml.safe_load(path.read_bytes())
    except OSError as error:
        raise ToolkitError(f"{what} '{path}' cannot be read: {error.strerror}") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f", line {mark.line + 1}" if mark else ""
        problem = getattr(error, "problem", None) or "not YAML"
        raise ToolkitError(f"{what} '{path}'{line}: {problem}") from error
    if not isinstance(data, dict):
        raise ToolkitError(f"{what} '{path}' must be a mapping with {parts}")
    return data


def parse_set(option: str) -> tuple[str, list[Any]]:
    """Split `path.to.key=v1,v2` into the path and its YAML values; a value that is a list stands in brackets.

    Raises:
        ToolkitError: there is no `=`, or a value is not YAML.
    """
    path, separator, text = option.partition("=")
    if not separator or not path or not text:
        raise ToolkitError(f"--set takes path.to.key=value[,value], got '{option}'")
    try:
        return path, list(yaml.safe_load(f"[{text}]"))
    except yaml.YAMLError as error:
        raise ToolkitError(f"--set {path}: '{text}' is not a list of YAML values") from error


def assign(data: dict[str, Any], path: str, value: Any) -> None:
    """Set a dotted path. Naming another implementation drops the former one's settings.

    Below a slot lie the settings of an implementation, which may choose others in turn: what is not there yet on the
    way to such a setting is made, and checked with them.

    Raises:
        ToolkitError: a group on the way to a slot is not there; the nearest is offered.
    """
    *parents, last = keys_of(path)
    node: Any = data
    for depth, key in enumerate(parents):
        below_slot = _below_slot(parents[:depth])
        child = node.get(key, {} if below_slot else None)
        if isinstance(child, str) and (below_slot or key in _SLOTS):
            child = {"name": child}
        if not isinstance(child, dict):
            where = ".".join(parents[: depth + 1])
            raise ToolkitError(f"cannot set '{path}': there is no '{where}'{suggest(key, [str(k) for k in node])}")
        node[key] = child
        node = child
    former = node.get(last)
    chosen = isinstance(value, str) and isinstance(former, dict) and _below_slot([*parents, last])
    if chosen and former.get("name", value) == value:
        former["name"] = value
    else:
        node[last] = value


def keys_of(path: str) -> list[str]:
    """The keys of a dotted path; `slot.name` is the slot itself, whose implementation it names."""
    *parents, last = path.split(".")
    return parents if last == "name" and _below_slot(parents) else [*parents, last]


def _below_slot(keys: Sequence[str]) -> bool:
    return any(key in _SLOTS for key in keys)
