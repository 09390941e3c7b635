"""Positions that are only sent when they matter: a line that both sides follow, and when the next one is due."""
