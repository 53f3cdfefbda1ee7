"""Robots to drive: the simulated arm, and one that was recorded or only imagined."""
