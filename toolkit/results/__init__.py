"""What a run leaves: rows, errors, intervals, tests, tables and reports."""
