"""A fused model, rendered and compared with the goal image."""
