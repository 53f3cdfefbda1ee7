"""Paths of an arm from one pose to another that touch nothing."""
