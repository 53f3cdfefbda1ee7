"""The paper's Sec. Method B: motions -> moves, grasps, ways of an arm, and the table set right."""
