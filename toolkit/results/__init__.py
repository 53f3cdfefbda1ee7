"""What a run writes: rows, errors, intervals, tests, tables and reports."""
