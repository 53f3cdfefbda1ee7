"""Where a gripper takes hold of an object that was never seen before."""
