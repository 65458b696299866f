"""The hypothesis filter: posterior probabilities of faults."""
