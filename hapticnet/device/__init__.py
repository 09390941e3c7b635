"""The fingertip device: what it is made of, how it moves and senses, and a simulated one.

Three servos lift a platform toward the fingertip; a force sensor under the platform says how hard it presses.
``base`` is what the master sees of any device, ``simulated`` the one that needs no hardware.
"""
