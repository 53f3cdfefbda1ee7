"""Image-goal object rearrangement by multi-view fusion: a research toolkit of swappable, measured stages.

The package reads as the paper: `perception` is its Sec. Method A, `rearrangement` its Sec. Method B, each with one
folder for every stage; `types` and `geometry` hold what passes between them, `harness` runs and measures them.
"""

__version__ = "0.1.0"
