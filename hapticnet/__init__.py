"""Haptic teleoperation with perceptual deadband compression.

Follow one force sample through the rooms in the order that data takes:
``scene`` → ``codec`` → ``protocol`` → ``channel`` → (UDP) → ``protocol`` → ``codec`` → ``control`` → ``device``.
``docs/architecture.md`` walks that way file by file.
"""

__version__ = "0.1.0"
