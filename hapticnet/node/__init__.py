"""The two ends, and both together in virtual time: the only place where the rooms meet."""
