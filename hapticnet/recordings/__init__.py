"""Recordings from CSV, NumPy, MATLAB and Parquet files: columns, units, times and plausibility."""
