"""What is learned from runs: a report on a vehicle before flight, and the thesis reproduced."""
