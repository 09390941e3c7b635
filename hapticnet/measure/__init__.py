"""How good what is applied is, and the best that any encoder could do."""
