"""The experiment: the person's JND, the ordering of three tissues, simulated observers and the analysis."""
