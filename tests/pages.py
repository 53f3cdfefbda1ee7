"""Runs without their pages: most of what a small run computes."""

from __future__ import annotations

import pytest


def draw_no_pages(patch: pytest.MonkeyPatch) -> None:
    """From here on, runs of this process draw no page and no pictures."""
    from toolkit.harness.ablate import Ablation
    from toolkit.harness.rearrange import Rearrangement

    for kind in (Ablation, Rearrangement):
        patch.setattr(kind, "illustrate", lambda self, job, rows: None)
        patch.setattr(kind, "write_page", lambda self, run: run)
