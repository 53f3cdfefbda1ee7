"""For people who write implementations: templates, checks, and the pytest plugin."""
