"""What comes out: runs, their summaries, and how both are kept on disk."""
