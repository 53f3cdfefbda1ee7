"""Refiners: from a fused model and starting poses to a refined, verified motion."""
