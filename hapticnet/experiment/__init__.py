"""Experiments: load recordings, play the paper's conditions, compare and draw results."""
