"""MuJoCo models as scenes of hapticnet: ``hapticnet slave --scene hapticnet_mujoco:Scene:model=FILE.xml,tool=BODY``."""

from hapticnet_mujoco.scene import Scene

__all__ = ["Scene"]
