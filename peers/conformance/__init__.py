"""One suite for every peer: golden vectors, sessions in lockstep with hapticnet, and malformed input."""
