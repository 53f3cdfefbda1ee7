"""Which object is moved where, and when (Sec. Method B)."""
