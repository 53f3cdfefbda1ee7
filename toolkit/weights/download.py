"""Downloads that can be resumed, and that never leave part of a file under the final name."""

from __future__ import annotations

import os
import urllib.error
import urllib.request
from contextlib import suppress
from pathlib import Path

from rich.console import Console

from toolkit.progress import Progress

_CHUNK = 1 << 18
_TIMEOUT_S = 20
_RANGE_REFUSED = 416
_HUB = "hf://"


def source_url(source: str) -> str:
    """`hf://owner/repo/file` as the URL it stands for, below $HF_ENDPOINT; https:// addresses as they are."""
    if source.startswith(_HUB):
        owner, repo, file = source.removeprefix(_HUB).split("/", 2)
        endpoint = os.environ.get("HF_ENDPOINT", "https://huggingface.co").rstrip("/")
        return f"{endpoint}/{owner}/{repo}/resolve/main/{file}"
    return source


def download(source: str, target: Path, left: Path) -> None:
    """Fetch a source into `target`, going on where an earlier attempt stopped.

    Args:
        source: an address.
        target: written by this process alone.
        left: what an attempt that is cut off leaves for the next one, whichever process that is.

    Raises:
        OSError: the source does not answer, or the file cannot be written.
    """
    with suppress(FileNotFoundError):
        left.rename(target)
    try:
        _receive(source, target, left.stem)
    except BaseException:
        with suppress(FileNotFoundError):
            target.replace(left)
        raise


def _receive(source: str, target: Path, title: str) -> None:
    if source.startswith(_HUB) and os.environ.get("HF_HUB_OFFLINE", "0").lower() not in ("", "0", "false", "no", "off"):
        raise OSError(f"{source} is not asked for: $HF_HUB_OFFLINE is set")
    have = target.stat().st_size if target.is_file() else 0
    request = urllib.request.Request(source_url(source), headers={"Range": f"bytes={have}-"} if have else {})
    token = os.environ.get("HF_TOKEN")
    if token and source.startswith(_HUB):
        request.add_unredirected_header("Authorization", f"Bearer {token}")
    try:
        answer = urllib.request.urlopen(request, timeout=_TIMEOUT_S)
    except urllib.error.HTTPError as error:
        if error.code != _RANGE_REFUSED or not have:
            raise
        # What is left of an earlier attempt does not fit what the source has now.
        target.unlink()
        return _receive(source, target, title)
    with answer:
        if answer.headers.get_content_type() == "text/html":
            raise OSError(f"{source} answers with a web page; is there a login page or a proxy in between?")
        resumed = answer.status == 206
        length = int(answer.headers.get("Content-Length", 0))
        expected = length + (have if resumed else 0) if length else 0
        with (
            target.open("ab" if resumed else "wb") as file,
            Progress(Console(stderr=True)).step(f"Downloading {title}", expected) as advance,
        ):
            advance(file.tell())
            while chunk := answer.read(_CHUNK):
                file.write(chunk)
                advance(len(chunk))
    if expected and target.stat().st_size != expected:
        raise OSError(f"{source}: the connection ended after {target.stat().st_size} of {expected} bytes")
    return None
