"""Recordings that people have, as capture folders: one file per kind, and one way from there to a capture.

recording.py   what each kind gives       choosing.py   which of its images are taken
folders.py     pictures and depth files   writing.py    the chosen ones -> a capture
trajectory.py  poses over time            settings.py   numbers on the command line
"""

from toolkit.data.importing.recording import Importer
from toolkit.registry import Registry

IMPORTERS: Registry[Importer] = Registry(
    "import kind",
    "toolkit.importers",
    {
        "bop": "toolkit.data.importing.bop:Bop",
        "colmap": "toolkit.data.importing.colmap:Colmap",
        "nerfstudio": "toolkit.data.importing.nerfstudio:Nerfstudio",
        "open3d": "toolkit.data.importing.open3d:Open3D",
        "polycam": "toolkit.data.importing.polycam:Polycam",
        "realsense": "toolkit.data.importing.realsense:RealSense",
        "ros": "toolkit.data.importing.ros:Ros",
        "tum": "toolkit.data.importing.tum:Tum",
    },
)
"""Kinds of recordings by name; other distributions add theirs behind the entry point `toolkit.importers`."""
