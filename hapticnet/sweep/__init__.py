"""Studies of many runs: every combination of some settings, computed in shards by the cores of one or more machines."""
