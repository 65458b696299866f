"""Records of other programs: files of any recorder, and the maps that make telemetry of them."""
