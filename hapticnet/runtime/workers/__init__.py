"""Several processes that are one slave: they share its address, its limits, its console and its report."""
