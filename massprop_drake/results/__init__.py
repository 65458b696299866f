"""What comes out: runs, their summaries and signals, and how they are kept on disk."""
