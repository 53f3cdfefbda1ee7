"""Gripper, surface and free room: what graspers measure."""
