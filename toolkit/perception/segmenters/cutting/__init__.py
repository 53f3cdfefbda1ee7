"""What stands on a table, seen in depth and in colour."""
