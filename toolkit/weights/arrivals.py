"""Whether what has arrived can be what was asked for, where no digest tells."""

from __future__ import annotations

from pathlib import Path

_PICKLE_OR_ZIP = (b"PK\x03\x04", b"\x80")
_BEGINNINGS = {
    ".ckpt": _PICKLE_OR_ZIP,
    ".pt": _PICKLE_OR_ZIP,
    ".pth": _PICKLE_OR_ZIP,
    ".onnx": (b"\x08",),
    ".json": (b"{", b"["),
}
"""How files of a type begin."""

_PAGES = (b"<!doctype", b"<html", b"<head", b"<?xml")
_TOLERANCE = 0.25
"""Part of a card's rounded size by which a file may differ from it."""

_SAFETENSORS = 8
"""Bytes of the header's length, before the header, which is JSON."""


def require_plausible(path: Path, suffix: str, size_mb: float | None, source: str) -> None:
    """Raise OSError for a web page, a file that does not begin as its type does, or one of quite another size.

    Args:
        path: what has arrived.
        suffix: the type it must be of, as file names end; types without a known beginning are believed.
        size_mb: its size as the card rounds it, MB; None where it is not known.
        source: for the message.
    """
    with path.open("rb") as file:
        begin = file.read(512)
    if begin.lstrip().lower().startswith(_PAGES):
        raise OSError(f"{source} delivers a web page; is there a login page or a proxy in between?")
    at = _SAFETENSORS if suffix == ".safetensors" else 0
    if not begin[at:].startswith(_BEGINNINGS.get(suffix, (b"{",) if at else (b"",))):
        raise OSError(f"what {source} delivers is no {suffix} file")
    got_mb = path.stat().st_size / 1e6
    if size_mb is not None and abs(got_mb - size_mb) > _TOLERANCE * size_mb:
        raise OSError(f"what {source} delivers is of {got_mb:.1f} MB instead of about {size_mb:g} MB")
