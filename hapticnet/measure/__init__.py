"""Error and quality of applied forces, and the fewest packets that any encoder needs."""
