"""Results: runs, their summaries and signals, and their storage on disk."""
