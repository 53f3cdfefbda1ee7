"""What was estimated, in the files that other tools read: one file per kind."""

from toolkit.data.exporting.results import Exporter
from toolkit.registry import Registry

EXPORTERS: Registry[Exporter] = Registry(
    "export kind",
    "toolkit.exporters",
    {
        "bop": "toolkit.data.exporting.bop:Bop",
        "ply": "toolkit.data.exporting.ply:Ply",
        "ros": "toolkit.data.exporting.ros:Ros",
    },
)
"""Kinds of files by name; other distributions add theirs behind the entry point `toolkit.exporters`."""
