"""Systems of the true vehicle."""
