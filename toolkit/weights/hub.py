"""Files of model repositories through huggingface_hub: its cache, mirror, token and offline mode count."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path


def has_hub() -> bool:
    """Say whether huggingface_hub is installed (`pip install 'rearrange-toolkit[hub]'`)."""
    return importlib.util.find_spec("huggingface_hub") is not None


def fetch_from_hub(address: str, target: Path) -> None:
    """Copy one file out of the hub's cache, which huggingface_hub fills where it may.

    Args:
        address: `owner/repo/file`.
        target: where the file goes.

    Raises:
        OSError: it is not in the cache, and the hub cannot be reached, has no such file, or is not asked
            ($HF_HUB_OFFLINE).
    """
    from huggingface_hub import get_hf_file_metadata, hf_hub_download, hf_hub_url, try_to_load_from_cache
    from huggingface_hub.utils import are_progress_bars_disabled, disable_progress_bars, enable_progress_bars, logging

    logging.set_verbosity_error()
    owner, repo, file = address.split("/", 2)
    silent = are_progress_bars_disabled()
    disable_progress_bars()
    try:
        if not isinstance(try_to_load_from_cache(f"{owner}/{repo}", file), str):
            # Fails at once where the hub cannot be reached; the download itself tries again for half a minute first.
            get_hf_file_metadata(hf_hub_url(f"{owner}/{repo}", file))
        shutil.copyfile(hf_hub_download(f"{owner}/{repo}", file), target)
    except Exception as error:
        # The library's errors, and those of what it sends requests with, have no common base.
        raise OSError(f"huggingface_hub cannot fetch {address}: {' '.join(str(error).split())}") from error
    finally:
        if not silent:
            enable_progress_bars()
