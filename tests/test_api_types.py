"""What a user writes against ``import hapticnet as hn`` is checked by mypy, and mistakes are found."""

import subprocess
import sys

USER = """
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import hapticnet as hn


class Hold:
    def __init__(self, axes: int) -> None:
        self.held: tuple[float, ...] = (0.0,) * axes

    def encode(
        self, t_us: int, stimulus: tuple[float, ...], position: tuple[float, ...] | None = None
    ) -> bytes | None:
        return b""

    def refresh(self) -> None: ...

    def decode(self, t_us: int, payload: bytes) -> None: ...

    def reconstruct(
        self, t_us: int, position: tuple[float, ...] | None = None, position_us: int | None = None
    ) -> tuple[float, ...]:
        return self.held


@dataclass(frozen=True)
class Mine:
    name: ClassVar[str] = "mine"
    needs_position: ClassVar[bool] = False
    law: hn.WeberLaw = field(default_factory=hn.WeberLaw)

    def encoder(self, axes: int) -> Hold:
        return Hold(axes)

    def decoder(self, axes: int) -> Hold:
        return Hold(axes)


mine: hn.Codec = Mine()
force = np.ones(100)
result = hn.encode(force, t_s=np.arange(100) / 1e3, codec="deadband", multiplier=2, step_n=0.001)
reveal_type(result)
reveal_type(result.report().rmse_n)
rows = hn.compare({"a": force, "b": [1.0, 2.0]}, codecs=["raw", hn.make_codec("deadband")], jobs=2)
reveal_type([row.cost.sent for row in rows])
encoder: hn.Encoder = hn.make_codec().encoder(1)
reveal_type(encoder.encode(0, (1.0,)))
link = hn.virtual_link(scene="paper:1", feedback="wifi")
link.run(seconds=1)
reveal_type(link.report().felt_rmse_n)
reveal_type(hn.fewest_holds(force, law=hn.WeberLaw(multiplier=2)))
hn.encode(force, rate_hz="fast")
hn.encode(force, 1000)
link.run(1)
hn.nothing
"""

REVEALED = ("hapticnet.api.encoding.Encoded", "float", "list[int]", "bytes | None", "float", "int")
MISTAKES = (
    'Argument "rate_hz" to "encode" has incompatible type "str"',
    'Too many positional arguments for "encode"',
    'Too many positional arguments for "run" of "VirtualLink"',
    'Module has no attribute "nothing"',
)


def test_a_users_file_is_typed(tmp_path):
    (tmp_path / "user.py").write_text(USER)
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--cache-dir", tmp_path / "cache", "user.py"]
    said = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path).stdout
    revealed = [line.split('"')[1] for line in said.splitlines() if "Revealed type" in line]
    assert tuple(each.replace("builtins.", "") for each in revealed) == REVEALED
    errors = [line for line in said.splitlines() if ": error: " in line and line.startswith("user.py")]
    assert len(errors) == len(MISTAKES), said
    for mistake in MISTAKES:
        assert any(mistake in error for error in errors), said
