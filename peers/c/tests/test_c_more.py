"""Few positions, announced contact, codecs that follow the hand: the same bytes and forces as hapticnet's."""

import ctypes
import random
import re
import struct

import msgpack
import numpy as np
import pytest
from test_c_sessions import CODECS, Pair
from test_c_vectors import MODELS, PROTOCOL, OpenMaster

import peer
from conformance.scenes import Spring
from conformance.session import NETWORKS
from hapticnet.codec import positions
from hapticnet.errors import PeerError
from hapticnet.node import decoders
from hapticnet.node.settings import SlaveSettings
from hapticnet.node.slave import SlaveNode
from hapticnet.protocol.settings import SessionSettings
from hapticnet.samples import ForceSample
from hapticnet.scene.ahead import LayerAhead, stiffest_at
from hapticnet.scene.scene import Scene
from hapticnet.scene.settings import Tissue
from hapticnet.stiffness_bound import StiffnessBound
from tests.peers import KEY

LINE = {"position_share": 0.25}
AHEAD = {"announced": True}
PREDICTED = {"predicted": True}
FOLLOWING = [
    "motion-predictive",
    "passive-extrapolative",
    "passive-interpolative",
    "model-mediated",
    "velocity-adaptive",
]
AXES = [(network, 1 + i % 3) for i, network in enumerate(NETWORKS)]
FAR = "near the end", "too slow"  # networks on which no answer along a line is fresh


class Soft(Spring):
    """The springs with dampers. It tells the layers ahead, how stiff it is here, and can be copied."""

    damping, far = 2.0, 1e3

    def __init__(self, axes):
        super().__init__(axes)
        self.t_us, self.place = None, (0.0,) * axes

    def step(self, sample):
        elapsed_us = 0 if self.t_us is None else sample.t_us - self.t_us
        speeds = [0.0] * self.axes
        if elapsed_us > 0:
            speeds = [1e6 * (x - was) / elapsed_us for x, was in zip(sample.position_m, self.place, strict=True)]
        self.t_us, self.place = sample.t_us, sample.position_m
        depths = [x - 0.01 for x in self.place]
        force_n = [
            max(0.0, 300.0 * d + self.damping * v) if d > 0.0 else 0.0 for d, v in zip(depths, speeds, strict=True)
        ]
        return ForceSample(sample.t_us, tuple(force_n))

    def stiffness_bound(self):
        inside = [x > 0.01 for x in self.place]
        low_m = tuple(0.01 if each else -self.far for each in inside)
        high_m = tuple(self.far if each else 0.01 for each in inside)
        return StiffnessBound(300.0 * any(inside), self.damping * any(inside), low_m, high_m)

    def ahead(self):
        normals = np.eye(self.axes).tolist()
        return [LayerAhead(0.01, 300.0, viscosity_n_s_per_m=self.damping, normal=tuple(each)) for each in normals]

    def copied(self):
        made = type(self)(self.axes)
        made.t_us, made.place = self.t_us, self.place
        return made


TISSUES = {
    "plain": {},
    "viscous": {"viscosity_n_s_per_m": 3.0},
    "stiffening": {"stiffening_per_m": 80.0, "viscosity_n_s_per_m": 1.0},
    "rubbing": {"shaft_friction_n": 0.4},
    "recovering": {"recovery_time_s": 0.2},
}


def tissue(kind, count=2):
    """Return a maker of tissues with some properties, one behind the other."""
    places_m = [0.012 + 0.014 * i / (count - 1) for i in range(count)]
    properties = {"stiffness_n_per_m": 500.0 / count, "breach_force_n": 1.5} | TISSUES[kind]
    return lambda _: Scene([Tissue(name=f"{x_m:g}", rest_position_m=x_m, **properties) for x_m in places_m])


@pytest.mark.parametrize(("network", "axes"), AXES)
def test_few_positions_are_equal_to_the_byte_and_the_forces_to_the_bit(lib, network, axes):
    pair = Pair(lib, network, axes=axes, more=LINE, scene=Soft)
    pair.run(2.5)
    pair.check(least_n=0.0 if network in FAR else 3.0)
    assert len(pair.of_c.forward.log) < 1200


@pytest.mark.parametrize(("network", "axes"), AXES)
def test_announced_contact_is_felt_as_in_hapticnet(lib, network, axes):
    pair = Pair(lib, network, axes=axes, more=AHEAD, scene=Soft)
    pair.run(6.0 if network == "near the end" else 2.5)
    pair.check(least_n=0.0 if network == "too slow" else 3.0)
    assert pair.of_python.master.on_model == (network != "too slow")


@pytest.mark.parametrize("codec", FOLLOWING)
@pytest.mark.parametrize("network", ["disorder", "near the end"])
def test_codecs_that_follow_the_hand_are_limited_alike(lib, codec, network):
    pair = Pair(lib, network, codec, axes=2)
    pair.run(6.0 if network == "near the end" else 2.5)
    pair.check(least_n=3.0)


class Broken(Soft):
    """Springs that yield above 3 N, so that what was learned before is soon wrong."""

    def step(self, sample):
        force_n = super().step(sample).force_n
        return ForceSample(sample.t_us, tuple(x if x < 3.0 else 0.2 * x for x in force_n))


def test_the_limit_holds_wrong_forces_back(lib, monkeypatch):
    held_back = []
    limited = decoders.BoundedDecoder._limited

    def counted(self, force_n):
        applied_n = limited(self, force_n)
        held_back.append(applied_n != force_n)
        return applied_n

    monkeypatch.setattr(decoders.BoundedDecoder, "_limited", counted)
    pair = Pair(lib, "slow", "motion-predictive", axes=2, scene=Broken)
    pair.run(4.0)
    pair.check(least_n=1.0)
    assert sum(held_back) > 50


@pytest.mark.parametrize(
    ("codec", "more"),
    [(codec, LINE) for codec in [*dict(CODECS), *FOLLOWING]]
    + [(codec, LINE | AHEAD) for codec in ("deadband", "linear-predictive", "motion-predictive", "model-mediated")],
)
def test_every_codec_agrees_with_few_positions(lib, codec, more):
    pair = Pair(lib, "lossy", codec, axes=2, more=more, scene=Soft)
    pair.run(1.5)
    pair.check(least_n=3.0)


@pytest.mark.parametrize("kind", TISSUES)
@pytest.mark.parametrize("more", [LINE, AHEAD, LINE | AHEAD], ids=["few", "announced", "both"])
def test_tissues_that_break_are_felt_alike(lib, kind, more):
    pair = Pair(lib, "disorder", "motion-predictive", more=more, scene=tissue(kind))
    pair.run(1.5)
    pair.check(least_n=1.4)


@pytest.mark.parametrize("more", [AHEAD, LINE | AHEAD], ids=["announced", "both"])
def test_a_model_that_is_late_catches_up_over_several_positions(lib, more, monkeypatch):
    late = []
    begin = decoders.AnnouncedDecoder._begin

    def begun(self, *model):
        made = begin(self, *model)
        late.append(made.cost * len(made.to_play) > decoders.MOST_PLAYED)
        return made

    monkeypatch.setattr(decoders.AnnouncedDecoder, "_begin", begun)
    pair = Pair(lib, "disorder", "deadband", more=more, scene=tissue("rubbing", 7))
    pair.run(3.0)
    pair.check(least_n=1.0)
    assert sum(late) > 10


@pytest.mark.parametrize("codec", ["deadband", "motion-predictive"])
@pytest.mark.parametrize("more", [PREDICTED, PREDICTED | LINE, PREDICTED | AHEAD], ids=["all", "few", "announced"])
def test_a_predicted_hand_changes_nothing_but_the_limit(lib, codec, more):
    pair = Pair(lib, "lossy", codec, axes=2, more=more, scene=Soft)
    pair.run(1.5)
    pair.check(least_n=3.0)


MANY = [("deadband", LINE), ("motion-predictive", {}), ("deadband", AHEAD), ("motion-predictive", LINE | AHEAD)]
many = pytest.mark.parametrize(("codec", "more"), MANY, ids=["few", "following", "announced", "all"])


@many
@pytest.mark.parametrize(("seconds", "ways"), [(0.25, {"forward": False}), (2.5, {})], ids=["a little", "long"])
def test_a_silent_link_is_survived_alike(lib, codec, more, seconds, ways):
    pair = Pair(lib, "lossy", codec, more=more, scene=Soft)
    pair.run(1.0)
    pair.shut(0.0, seconds, **ways)
    pair.run(seconds + 1.5)
    assert pair.of_c.master.state == "established"
    pair.check(least_n=3.0)


@many
def test_a_silence_in_free_air_ends_the_link_after_a_second_with_few_positions(lib, codec, more):
    pair = Pair(lib, "perfect", codec, more=more, scene=Soft)
    pair.run(0.05)
    pair.shut(0.0, 0.8)
    pair.run(0.12)
    states = [pair.of_c.master.state]
    pair.run(0.3)
    states.append(pair.of_c.master.state)
    assert states == ["established", "established" if more == LINE else "stale"]
    pair.run(1.5)
    pair.check(least_n=3.0)


@many
def test_sessions_that_change_are_not_felt(lib, codec, more):
    pair = Pair(lib, "disorder", codec, more=more, scene=Soft)
    pair.run(1.0)
    pair.each(lambda loop: loop.slave._end(loop.slave.contexts[0], "moved", loop.now_us))
    pair.run(0.7)
    pair.each(restarted)
    pair.run(1.5)
    assert (pair.of_c.master.state, pair.of_c.slave.session_count) == ("established", 1)
    pair.check(least_n=3.0)


def restarted(loop):
    """Restart the slave of a loop: it knows no session any more."""
    axes = loop.master.axes
    loop.slave = SlaveNode(lambda _: Soft(axes), SlaveSettings(), np.random.default_rng([9, 9]))


@many
def test_sequence_numbers_wrap_without_a_change_of_force(lib, codec, more):
    session = SessionSettings(first_sequence=2**32 - 60)
    pair = Pair(lib, "disorder", codec, more=more, scene=Soft, slave={"session": session})
    pair.run(0.2)
    pair.of_python.master.session._stream.sequence = 2**32 - 50
    lib.shim_set_sequence(pair.of_c.master.pointer, ctypes.c_uint32(2**32 - 50))
    pair.run(2.0)
    pair.check(least_n=3.0)


@many
def test_a_clock_that_jumps_changes_nothing(lib, codec, more):
    pair = Pair(lib, "slow", codec, more=more, scene=Soft)
    for jump_us in (-300_000, 40_000, -5_000_000, 30_000_000, 0):
        pair.run(0.7)
        for loop in pair.loops:
            loop.now_us += jump_us
            loop._next_tick_us += jump_us
    pair.check()


@many
def test_any_rate_and_a_slave_that_grants_less_agree(lib, codec, more):
    pair = Pair(lib, "lossy", codec, more=more, scene=Soft, rate_hz=997.3, slave={"fastest_rate_hz": 700.0})
    pair.run(1.5)
    pair.check(least_n=0.5)


@many
def test_sealed_sessions_agree(lib, codec, more):
    pair = Pair(lib, "disorder", codec, more=more, scene=Soft, key=KEY)
    pair.run(2.0)
    pair.check(least_n=3.0)
    assert all(data[1] == 2 for _, data in pair.of_c.forward.log)


@pytest.mark.parametrize(
    ("share", "outcome"), [(0.25, "established"), (float(np.float32(0.3)), "established"), (0.26, "connecting")]
)
def test_a_grant_gives_the_share_that_was_asked_for(lib, share, outcome):
    asked = 0.25 if share != float(np.float32(0.3)) else 0.3
    grant = msgpack.unpackb(msgpack.unpackb(msgpack.unpackb(bytes.fromhex(PROTOCOL["welcome"]["hex"]))[4])[1])
    grant[7] = share
    assert OpenMaster(lib, grant=msgpack.packb(grant), more={"position_share": asked}).master.state == outcome


def test_a_request_that_lacks_memory_or_has_a_wrong_share_is_refused(lib):
    for more in ({"position_share": 0.95}, {"position_share": -0.1}, {"position_share": float("nan")}):
        assert "share" in peer.Master(lib, lambda: 1, lambda _: (0.0,), **more).wrong
    for more in ({"codec": "model-mediated"}, LINE, AHEAD):
        master = peer.Master(lib, lambda: 1, lambda _: (0.0,), **more)
        assert master.wrong is None
        master.kept.more = None
        assert b"hn_more_init" in lib.hn_master_init(master.pointer, ctypes.byref(master.kept), None, None)


def test_memory_is_as_the_readme_says(lib):
    said = re.search(r"(\d+) kB, (\d+) kB and (\d+) kB for one axis", (peer.HERE / "README.md").read_text())
    each = LINE, AHEAD, {"codec": "motion-predictive"}
    masters = [peer.Master(lib, lambda: 1, lambda _: (0.0,), **more) for more in each]
    sizes = [lib.hn_more_bytes(ctypes.byref(master.kept)) for master in masters]
    assert [round(size / 1000) for size in sizes] == [int(each) for each in said.groups()]


def reads(read, *arguments):
    try:
        read(*arguments)
    except PeerError:
        return False
    return True


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_lines_bounds_and_models_are_read_by_both_or_by_neither(lib, axes):
    chance = random.Random(axes)
    numbers = [0.0, 0.01, -0.5, 9.99, 10.0, 10.1, 99.0, 101.0, 1e9, 1.1e9, 3e15, float("inf"), float("nan")]
    outcomes = {True: 0, False: 0}
    models = [bytes.fromhex(each["payload"]) for each in MODELS["models"] if each["axes"] == axes]
    for _ in range(6000):
        some = [chance.choice(numbers[: chance.choice([4, 9, 13])]) for _ in range(9)]
        halves = struct.pack(f">{2 * axes}e", *(min(x, 6e4) for x in some[: 2 * axes]))[
            : chance.choice([0, 2, 4]) * axes
        ]
        line = struct.pack(f">{axes}f", *some[:axes]) + halves
        place, t_us = peer.vector([]), chance.choice([-5, 0, 1, 30_000, 77_777, 100_000, 10**6])
        read = lib.shim_read_line(line, ctypes.c_size_t(len(line)), axes, ctypes.c_int64(t_us), place)
        assert read == reads(positions.unpack_line, 0, line, axes)
        if read:
            assert tuple(place[:axes]) == positions.unpack_line(0, line, axes).at(t_us)
        bound = struct.pack(f">{3 + 2 * axes}f", *some[: 3 + 2 * axes])
        bound = bound[: chance.choice([len(bound), len(bound), 0, 8])]
        assert lib.shim_read_bound(bound, ctypes.c_size_t(len(bound)), axes) == reads(
            positions.unpack_bound, bound, axes
        )
        model = bytearray(chance.choice(models) if models else bytes([1, 1, 0]))
        for _ in range(chance.randint(0, 2)):
            model[chance.randrange(len(model))] = chance.choice([0, 1, 2, 8, 63, 64, 0x3F, 0x7F, 0x80, 0xFF])
        good = reads(decoders.unpack_model, bytes(model), axes, stiffest_at(1000.0))
        memory = peer.state(lib, b"model")
        assert lib.shim_read_model(memory, bytes(model), ctypes.c_size_t(len(model)), axes) == good
        outcomes[good] += 1
        outcomes[read] += 1
    assert min(outcomes.values()) > 1000
