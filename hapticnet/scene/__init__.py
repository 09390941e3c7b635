"""What the operator touches: a needle against layers of virtual tissue, position in, contact force out."""
