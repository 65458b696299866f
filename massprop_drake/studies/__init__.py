"""Studies of many runs: a report on a vehicle before flight, campaigns of many flights, and designed maneuvers."""
