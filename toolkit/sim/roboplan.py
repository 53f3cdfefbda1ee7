"""RoboPlan, asked for before any work starts: nothing that imports it can be imported without it."""

from __future__ import annotations

import importlib.util

from toolkit.errors import ToolkitError


def require_roboplan() -> None:
    """Make sure of RoboPlan.

    Raises:
        ToolkitError: it is not installed here.
    """
    # Its packages share one namespace, which is there when any of them is.
    if any(importlib.util.find_spec(name) is None for name in ("roboplan", "roboplan.rrt", "roboplan.toppra")):
        raise ToolkitError("moving an arm needs RoboPlan: pip install 'rearrange-toolkit[arm]'")
