"""Instances looked for all over the table: hypotheses, their images, and which of them together explain the goal."""
