"""Searches over arrangements: what stands where, reached one move at a time."""
