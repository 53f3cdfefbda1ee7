"""Explainers: the goal image in terms of the current scene's objects, before any mask is final."""
