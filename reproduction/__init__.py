"""The thesis measured again: its figures and tables rerun, and each of its claims judged."""
