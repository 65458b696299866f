"""Exports of a run for the viewers of others: Foxglove and PlotJuggler by MCAP, and Rerun."""
