"""What commands print with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table

    from toolkit.progress import Progress


def say(*parts: Any) -> None:
    """Print lines as they are, never folded, so that paths can be copied; and tables. Brackets are no markup."""
    from rich.console import Console

    console = Console()
    for part in parts:
        console.print(part, highlight=False, markup=False, soft_wrap=isinstance(part, str))


def listing(*headings: str, typed: Sequence[str] = ()) -> Table:
    """An empty table with these columns; what people have to type, under the headings `typed`, is never broken."""
    from rich.table import Table

    table = Table()
    for heading in headings:
        table.add_column(heading, no_wrap=heading in typed, overflow="fold")
    return table


def bars() -> Progress:
    """Progress bars, beside what is printed."""
    from rich.console import Console

    from toolkit.progress import Progress

    return Progress(Console(stderr=True))
