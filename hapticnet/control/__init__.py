"""From decoded stimuli to a platform displacement: hold, limits and the force loop, in that order.

Each stage assumes the worst of the one before it, so that a fault anywhere ends in a platform that retracts.
"""
