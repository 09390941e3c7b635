"""Recordings from CSV, NumPy and MATLAB files: columns, units, times and plausibility."""
