"""Sockets, clocks, timers, ports and processes: run the sans-I/O nodes in real time. No lower layer uses them."""
