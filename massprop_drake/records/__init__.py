"""Records of other programs: files of any recorder, and how a map makes telemetry of them."""
