"""Captures in the BOP scene layout. BOP is in millimetres; this folder is the only place that knows.

schemas.py   what each JSON file must hold      images.py   pictures, depth and masks as arrays
reading.py   a folder -> Capture                lens.py     distortion taken out of them
writing.py   frames -> a folder                 masks.py    masks that come with a capture
"""

from toolkit.data.bop.masks import masked_scenes
from toolkit.data.bop.reading import capture_digest, load_capture, load_current, load_goal
from toolkit.data.bop.truth import load_models
from toolkit.data.bop.writing import write_capture

__all__ = [
    "capture_digest",
    "load_capture",
    "load_current",
    "load_goal",
    "load_models",
    "masked_scenes",
    "write_capture",
]
