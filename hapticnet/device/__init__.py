"""The fingertip device: mechanics, sensor, serial protocol, and a simulated device.

Three servos lift a platform toward the fingertip; a force sensor under the platform measures how hard it presses.
``base`` has the interface of any device, ``wired`` the real one, ``simulated`` one without hardware.
"""
