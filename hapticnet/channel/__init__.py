"""An emulated network, seeded: delay, jitter, loss, reordering, duplication and a rate limit."""
