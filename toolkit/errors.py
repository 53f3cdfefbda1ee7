"""The one exception that a user's mistake raises."""


class ToolkitError(Exception):
    """A user's mistake: the message says what is wrong and what to do, in one or two lines.

    The command line prints the message and exits with code 2; it never shows a traceback for this class.
    """
