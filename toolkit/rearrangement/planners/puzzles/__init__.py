"""Rearrangement puzzles with known answers, and how planners fare on them."""
