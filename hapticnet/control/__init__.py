"""From decoded stimuli to a platform displacement: hold, limits and force loop, in that order.

Each stage checks the output of the one before it, so that any fault retracts the platform.
"""
