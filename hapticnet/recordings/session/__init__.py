"""Recordings of hapticnet's own sessions: written as they grow, read back, and completed after a crash."""
