"""`toolkit plugin new`: a small installable distribution from a template that works."""

from toolkit.plugin_kit.scaffold.distribution import new_plugin

__all__ = ["new_plugin"]
