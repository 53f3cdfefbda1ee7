"""Who moves the objects and looks at the table: a simulator, a robot, or a recording."""
