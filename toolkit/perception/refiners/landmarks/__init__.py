"""Points of a fused model with descriptors, found again in the goal image."""
