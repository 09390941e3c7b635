"""Where positions come from: scripted insertions of a needle, or a recorded motion."""
