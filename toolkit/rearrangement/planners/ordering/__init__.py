"""Orders of moves, and places to stand aside."""
