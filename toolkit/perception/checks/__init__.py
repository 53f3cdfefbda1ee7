"""What captures get wrong, measured: one file per kind of check, plain functions of frames, findings as values."""
