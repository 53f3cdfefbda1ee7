"""Names of the files in a run folder, runs/<name>/<time>/."""

ROWS = "rows.jsonl"
RESOLVED = "experiment.resolved.yaml"
META = "meta.json"
SUMMARY = "summary.csv"
"""Written last of all figures: a run that has it has all its rows."""

PAGE = "report.html"
TABLE = "summary.md"
"""The page's main tables, as Markdown."""

TABLES = "tables"
"""Every table of the page, as CSV and LaTeX."""

FIGURES = "figures"
"""Every plot of the page, as SVG and PDF for print."""

PICTURES = "pictures"
"""The page's pictures as PNG, each with its caption as a text of the same name."""
