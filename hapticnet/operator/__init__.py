"""Sources of positions: scripted needle insertions and recorded motion."""
