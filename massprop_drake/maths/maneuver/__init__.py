"""Design of firings that make mass properties known, or tell which of several jets fails."""
