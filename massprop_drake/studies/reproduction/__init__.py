"""Reruns every figure and table of the thesis and says of each claim whether it holds."""
