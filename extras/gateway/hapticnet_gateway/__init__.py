"""A gateway: lets browser tabs be masters of a slave, and cannot read what they say to each other."""
