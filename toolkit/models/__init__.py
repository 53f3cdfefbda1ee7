"""Network definitions shared by training and inference."""
