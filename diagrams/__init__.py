"""The diagrams, one module each with `build(...) -> Diagram`."""
