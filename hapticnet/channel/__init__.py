"""A network to put between two nodes: delay, jitter, loss, reordering, duplication, a bottleneck; seeded."""
