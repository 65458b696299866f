"""Studies of many runs: a report on a vehicle before flight, campaigns, designs, and the thesis reproduced."""
