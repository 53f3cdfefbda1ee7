"""Tracks of the table's texture, and the camera poses that agree with them."""
