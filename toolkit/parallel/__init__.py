"""Work in processes, on this machine or on a cluster; the same results wherever it is done."""

from toolkit.parallel.cores import cores
from toolkit.parallel.workers import BACKENDS, Here, Workers, open_workers

__all__ = ["BACKENDS", "Here", "Workers", "cores", "open_workers"]
