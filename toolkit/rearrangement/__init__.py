"""The paper's Sec. Method B: from motions to moves, grasps and paths of an arm, until the table is as in the goal."""
