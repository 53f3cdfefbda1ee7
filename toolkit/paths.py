"""Where the toolkit keeps what it can make again."""

from __future__ import annotations

import os
from pathlib import Path


def cache_root() -> Path:
    """$TOOLKIT_CACHE, or ~/.cache/toolkit, as an absolute path; may not exist yet."""
    named = os.environ.get("TOOLKIT_CACHE")
    return Path(named).absolute() if named else Path.home() / ".cache" / "toolkit"
