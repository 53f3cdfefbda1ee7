"""Hypotheses, consensus and least squares: what the PnP solvers are made of."""
