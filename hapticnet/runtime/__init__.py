"""The only sockets, clocks, timers and processes: what carries the sans-I/O nodes through real time."""
