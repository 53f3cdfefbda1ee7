"""The one exception that a user's mistake raises, and how it names what may have been meant."""

from rapidfuzz import process


class ToolkitError(Exception):
    """A user's mistake: the message says what is wrong and what to do, in one or two lines.

    The command line prints the message and exits with code 2; it never shows a traceback for this class.
    """


def suggest(word: str, choices: list[str]) -> str:
    """The tail of an unknown-name message: the nearest choice, capitals or not; or all of them."""
    nearest = process.extractOne(word, choices, score_cutoff=60, processor=str.lower)
    if nearest:
        return f"; did you mean '{nearest[0]}'?"
    return f"; choose from: {', '.join(choices)}" if choices else ""
