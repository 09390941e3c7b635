"""Experiments: recordings taken in, the paper's conditions played, results compared and drawn."""
