"""Image-goal object rearrangement by multi-view fusion: a research toolkit of swappable, measured stages.

The package reads as the paper: `perception` is its Sec. Method A, `rearrangement` its Sec. Method B, each with one
folder for every stage; `types` and `geometry` hold what passes between them, `harness` runs and measures them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from toolkit.harness.session import Session

__all__ = ["Session", "__version__"]
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """Import what is heavy when it is first asked for: the command line starts without it."""
    if name == "Session":
        from toolkit.harness.session import Session

        return Session
    raise AttributeError(f"module 'toolkit' has no attribute '{name}'")
