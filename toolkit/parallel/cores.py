"""How many processes are worth starting on this machine."""

from __future__ import annotations


def cores() -> int:
    """Cores this process may use: those that its affinity and its container leave it, on any system."""
    import joblib  # here, since the command line starts without it

    return joblib.cpu_count()
