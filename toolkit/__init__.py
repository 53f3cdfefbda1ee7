"""Image-goal object rearrangement by multi-view fusion: a research toolkit of swappable, measured stages.

The package reads as the pipeline: `types` and `geometry` hold the values, `stages` names every stage and its
registry, one folder per stage holds its implementations, `pipeline` joins them, `ablate` measures them.
"""

__version__ = "0.1.0"
