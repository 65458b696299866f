"""What is learned from runs: a vehicle before flight, the thesis reproduced."""
