"""What commands print with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from toolkit.progress import Progress


def say(*parts: Any) -> None:
    """Print lines as they are, never folded, so that paths can be copied; and tables. Brackets are no markup."""
    from rich.console import Console

    console = Console()
    for part in parts:
        console.print(part, highlight=False, markup=False, soft_wrap=isinstance(part, str))


def bars() -> Progress:
    """Progress bars, beside what is printed."""
    from rich.console import Console

    from toolkit.progress import Progress

    return Progress(Console(stderr=True))
