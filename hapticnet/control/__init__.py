"""From decoded stimuli to a platform displacement: hold, limits and force loop, in that order."""
