"""Experiments: cells, workers, runs, and what a command of the command line does."""
