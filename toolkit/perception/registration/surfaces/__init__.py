"""The surfaces that depth shows, brought together from frame to frame."""
