"""Virtual tissues and the needle that touches them: position in, contact force out."""
