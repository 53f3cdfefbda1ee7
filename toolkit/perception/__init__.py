"""The paper's Sec. Method A: frames and goal image -> database -> the motion of every goal object."""
