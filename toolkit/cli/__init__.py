"""The command line: Typer only; nothing heavy is imported before a command needs it."""
