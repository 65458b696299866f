"""The hypothesis filter: what has failed, as a posterior probability."""
