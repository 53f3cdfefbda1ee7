"""Where the toolkit keeps what it can make again."""

from __future__ import annotations

import os
from pathlib import Path

from toolkit.errors import ToolkitError


def cache_root() -> Path:
    """$TOOLKIT_CACHE, or ~/.cache/toolkit, as an absolute path; may not exist yet.

    Raises:
        ToolkitError: neither is known: the variable is not set, and the user has no home.
    """
    named = os.environ.get("TOOLKIT_CACHE")
    if named:
        return Path(named).absolute()
    try:
        return Path.home() / ".cache" / "toolkit"
    except RuntimeError as error:
        raise ToolkitError("this user has no home folder; name one for the cache in $TOOLKIT_CACHE") from error
