"""The table that all images share: where it is, how it looks when it is empty, and what stands on it."""
