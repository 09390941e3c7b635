"""``import hapticnet as hn``: what users call, and how it refuses what cannot be right."""

import dataclasses
import subprocess
import sys
import types

import numpy as np
import pytest

import hapticnet as hn
from hapticnet.codec import registry
from hapticnet.codec.recording import encode_array

T_S = np.arange(2000) / 1000
FORCE = 2.0 + np.sin(2 * np.pi * T_S)
VECTORS = np.column_stack([FORCE, 0.5 * FORCE, -FORCE])


@pytest.fixture(autouse=True)
def nothing_registered(monkeypatch):
    monkeypatch.setattr(registry, "_user_codecs", {})


def test_every_public_name_is_there_and_nothing_heavy_is_imported_before_it_is_used():
    assert all(getattr(hn, name) is not None for name in hn.__all__)
    assert set(hn.__all__) <= set(dir(hn))
    with pytest.raises(AttributeError, match="module 'hapticnet' has no attribute 'nothing'"):
        hn.nothing  # noqa: B018
    script = "import sys, hapticnet; print([m for m in ('numpy', 'typer', 'msgpack') if m in sys.modules])"
    said = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert said.stdout == "[]\n"


def test_encode_does_what_the_codec_does_to_the_recording():
    result = hn.encode(FORCE, codec="deadband", multiplier=2.0, step_n=0.001)
    codec = registry.make_codec("deadband", hn.WeberLaw(multiplier=2.0), {"step_n": 0.001})
    expected = encode_array(codec, np.arange(2000) * 1000, FORCE[:, np.newaxis])
    assert result.codec == codec
    assert np.array_equal(result.sent, expected.sent)
    assert np.array_equal(result.decoded, expected.decoded[:, 0])
    assert np.array_equal(result.payload_bytes, expected.payload_bytes)


@pytest.mark.parametrize(
    "times", [{}, {"rate_hz": 1000}, {"t_s": T_S}, {"t_us": T_S * 1e6}, {"t_s": list(T_S + 1.7e9)}]
)
def test_times_are_given_by_rate_seconds_or_microseconds(times):
    result = hn.encode(FORCE, codec="linear-predictive", **times)
    assert np.array_equal(result.t_us - result.t_us[0], np.arange(2000) * 1000)


@pytest.mark.parametrize("force", [FORCE, FORCE.tolist(), FORCE.astype(np.float32), VECTORS, VECTORS[:, :1], [1, 2]])
def test_what_is_decoded_has_the_shape_of_what_was_given(force):
    result = hn.encode(force)
    assert result.decoded.shape == result.force.shape == np.shape(force)
    assert result.report().samples == len(force)


def test_a_recording_from_a_file_brings_its_own_times_and_positions(tmp_path):
    table = np.column_stack([2 * T_S, VECTORS, 1000 * VECTORS])
    names = "time [s],fx,fy,fz,x [mm],y [mm],z [mm]"
    np.savetxt(tmp_path / "force.csv", table, delimiter=",", header=names, comments="")
    recording = hn.load_recording(tmp_path / "force.csv", columns="fx,fy,fz", position="x,y,z")
    result = hn.encode(recording)
    assert result.t_us[-1] == 1999 * 2000
    assert result.decoded.shape == (2000, 3)
    assert result.position == pytest.approx(VECTORS)
    assert result.report().energy_peak_j is not None
    rows = hn.compare([recording, recording], codecs="raw")
    assert [row.trial for row in rows] == ["recording 1", "recording 2"]
    assert hn.fewest_holds(recording) > 1
    with pytest.raises(hn.SettingsError, match="a recording with times and positions; omit rate_hz"):
        hn.encode(recording, rate_hz=500)


@pytest.mark.plain
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"t_us": T_S}, "the median period of t_us is 0.001 µs; .* if these are seconds, pass them as t_s"),
        ({"t_s": T_S * 1e6}, "the median period of t_s is 1000 s; .* if these are microseconds, pass them as t_us"),
        ({"t_s": T_S * 1e3}, "t_s is 1 s; .* milliseconds, pass t_s = milliseconds / 1000"),
        ({"t_us": T_S * 1e3}, "t_us is 1 µs; .* milliseconds, pass t_s = milliseconds / 1000"),
        ({"t_us": np.zeros(2000)}, "t_us is 0 µs; .* give rate_hz"),
        ({"t_s": T_S[:99]}, "t_s has 99 values for 2000 samples"),
        ({"t_s": T_S[::-1]}, r"t_s\[1\] is 1.998 s, before t_s\[0\], 1.999 s"),
        ({"t_s": np.where(T_S == 0.5, np.nan, T_S)}, r"t_s\[500\] is nan"),
        ({"t_s": T_S, "rate_hz": 1000}, "times are given as rate_hz and t_s; give one of rate_hz, t_s and t_us"),
        ({"rate_hz": 0.0}, "rate_hz is 0.0 Hz; it must be between 0.001 and 1e"),
        ({"position": FORCE[:7]}, "position has 7 samples of 1 axis, force 2000 of 1"),
        ({"codec": "deadbnad"}, r"^unknown codec 'deadbnad' \(did you mean 'deadband'\?\); there are: raw, deadband, "),
        ({"codec": "deadband:step_n=0.1", "step_n": 0.1}, "parameter 'step_n' is given twice"),
        ({"gain": 1.0}, "codec 'deadband' has no parameter 'gain'; it has: step_n"),
        ({"weber_fraction": -1.0}, "Weber fraction is -1.0"),
        ({"step_n": np.ones((9, 9))}, "step_n is of type ndarray; it must be a number"),
    ],
)
def test_what_cannot_be_right_is_refused_with_the_value_seen(arguments, message):
    with pytest.raises(hn.HapticnetError, match=message) as refused:
        hn.encode(FORCE, **arguments)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("force", "message"),
    [
        ([], "force is empty"),
        (None, "force is None"),
        (["1", "2"], "force is of type <U1; it must be real numbers"),
        (np.array(["1.0", 2.0], dtype=object), "force is of type <U3; it must be real numbers"),
        (1j * FORCE, "force is of type complex128"),
        ([object()], "force is not made of numbers"),
        (FORCE.reshape(4, 500), r"force: recording of shape \(4, 500\); it must be \(n,\) or \(n, 1 to 3\)"),
        (np.where(T_S == 0.5, np.nan, FORCE), r"sample 500: stimulus \[nan\] is not finite"),
        ([[1, 2], [3]], "inhomogeneous"),
        ([10**400, 1], "not made of numbers"),
        (np.ma.array([1.0, 2.0], mask=[False, True]), "force has masked values"),
        (types.SimpleNamespace(columns=("t_us", "fx")), "force has a column 't_us'; select the columns of force"),
    ],
)
def test_forces_that_cannot_be_forces_are_refused(force, message):
    with pytest.raises(hn.SampleError, match=message):
        hn.encode(force)


def test_the_report_has_costs_and_errors_and_reads_well():
    report = hn.encode(FORCE, multiplier=2).report()
    assert report.packet_rate_reduction == 1 - report.sent / 2000
    assert 0 < report.exceed_jnd_fraction < 1
    assert report.packets_per_s == report.sent / 2.0
    assert report.rmse_n == hn.error_report(FORCE, hn.encode(FORCE, multiplier=2).decoded).rmse_n
    assert repr(report).splitlines()[1].split() == ["codec", "deadband"]
    assert "<td>rmse_n</td>" in report._repr_html_()
    assert dataclasses.asdict(report)["wire_bytes"] == report.wire_bytes


def test_a_result_is_drawn():
    import matplotlib as mpl
    from matplotlib import pyplot

    mpl.use("agg")
    force, sent, error = hn.encode(VECTORS, multiplier=2).plot(window_s=(0.5, 1.0))
    assert force.figure.get_suptitle() == "deadband, 0.5 to 1 s of 2 s"
    for axes, names in ((force, ["true force", "applied (held) force"]), (error, ["threshold", "error"])):
        assert [text.get_text() for text in axes.get_legend().get_texts()] == names
    assert "samples sent" in sent.get_title(loc="left")
    assert error.get_xlim() == (0.5, 1.0)
    assert len(hn.encode(FORCE).plot()) == 3
    with pytest.raises(hn.SettingsError, match="the recording ends at"):
        hn.encode(FORCE).plot(window_s=(100.0, 105.0))
    pyplot.close("all")


def test_without_an_optional_package_a_line_says_what_to_install(monkeypatch):
    rows = hn.compare(FORCE, codecs=["deadband"], multipliers=[1, 2])
    monkeypatch.setitem(sys.modules, "pandas", types.SimpleNamespace(DataFrame=list))
    table = rows.to_dataframe()
    assert [line["multiplier"] for line in table] == [1, 2]
    assert {"trial", "label", "sent", "rmse_n", "optimum_holds"} <= set(table[0])
    needing = {"pandas": rows.to_dataframe, "matplotlib": hn.encode(FORCE).plot}
    for package, call in needing.items():
        monkeypatch.setitem(sys.modules, package, None)
        with pytest.raises(hn.UnavailableError, match=rf"pip install {package}"):
            call()


def test_compare_has_a_row_for_each_codec_and_threshold():
    rows = hn.compare(FORCE, codecs=["raw", "deadband", "deadband:step_n=0.01"], multipliers=(1, 4), rate_hz=1000)
    assert [row.label for row in rows] == [
        "raw",
        "deadband",
        "deadband:step_n=0.01",
        "deadband",
        "deadband:step_n=0.01",
    ]
    assert [row.multiplier for row in rows] == [1, 1, 1, 4, 4]
    assert rows[3].cost.sent == len(hn.encode(FORCE, multiplier=4).sent)
    assert rows[3].limits.holds == hn.fewest_holds(FORCE, law=hn.WeberLaw(multiplier=4))
    assert rows[3].limits.lines == hn.fewest_lines(FORCE, law=hn.WeberLaw(multiplier=4))
    assert len(repr(rows).splitlines()) == 6
    assert rows._repr_html_().count("<tr>") == 6


def test_compare_takes_several_recordings_and_codec_objects():
    objects = [hn.make_codec("deadband", multiplier=3), "merging"]
    rows = hn.compare({"one": FORCE, "three": VECTORS}, codecs=objects, multipliers=[1], loss=0.05, seed=7)
    assert [row.trial for row in rows] == ["one", "one", "three", "three"]
    assert [(row.codec, row.multiplier) for row in rows] == 2 * [("merging", 1), ("deadband", 3)]
    assert [row.label for row in hn.compare(FORCE, codecs="deadband", multipliers=2)] == ["deadband"]
    assert [row.label for row in hn.compare(FORCE, codecs=objects[0])] == ["deadband"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"codecs": []}, "nothing to compare"), ({"loss": 2.0}, "loss is 2.0"), ({"t_us": T_S}, "if these are seconds")],
)
def test_a_comparison_that_cannot_be_made_is_refused(arguments, message):
    with pytest.raises(hn.HapticnetError, match=message):
        hn.compare(FORCE, **arguments)
    with pytest.raises(hn.SettingsError, match="force: 1 samples over no time"):
        hn.compare([1.0])


def test_measures_take_what_encode_gives():
    result = hn.encode(VECTORS, codec="deadband", position=0.01 * VECTORS)
    quality = hn.quality_report(VECTORS, result.decoded, sent=result.sent, rate_hz=1000, position=result.position)
    report = result.report()
    assert dataclasses.asdict(quality).items() <= dataclasses.asdict(report).items()
    energy = hn.energy_report(VECTORS, result.decoded, position=0.01 * VECTORS)
    assert energy.put_in_j > 0.0
    assert 0.0 <= energy.created_share < 0.1
    for measure, given, more, message in (
        (hn.error_report, (VECTORS, result.decoded[1:]), {}, "applied has 1999 samples of 3 axes, true 2000 of 3"),
        (hn.error_report, ([1.0], [np.nan]), {}, r"applied\[0\] is not finite"),
        (
            hn.quality_report,
            (VECTORS, VECTORS),
            {"sent": result.t_us},
            "sent must be increasing indices from 0 to 1999",
        ),
        (hn.energy_report, (VECTORS, VECTORS), {"position": FORCE}, "position has 2000 samples of 1 axis, true 2000"),
    ):
        with pytest.raises(hn.SampleError, match=message):
            measure(*given, **more)


def test_streaming_is_the_same_as_encoding_at_once_and_a_codec_object_keeps_its_law():
    codec = hn.make_codec("adaptive-predictive", multiplier=2)
    with pytest.raises(hn.SettingsError, match="codec is an object with its own law and parameters; omit multiplier"):
        hn.encode(FORCE, codec=codec, multiplier=2)
    encoder, decoder = codec.encoder(1), codec.decoder(1)
    sent, decoded = [], []
    for index, force_n in enumerate(FORCE.tolist()):
        payload = encoder.encode(1000 * index, (force_n,))
        if payload is not None:
            decoder.decode(1000 * index, payload)
            sent.append(index)
        decoded.append(decoder.reconstruct(1000 * index)[0])
    at_once = hn.encode(FORCE, codec=codec)
    assert at_once.codec is codec
    assert sent == at_once.sent.tolist()
    assert decoded == at_once.decoded.tolist()


def test_a_virtual_link_is_the_same_run_after_run():
    def run(times, seconds):
        link = hn.virtual_link(scene="paper:1", codec="deadband", forward="wifi", feedback="wifi,loss=5%", seed=3)
        for _ in range(times):
            link.run(seconds=seconds)
        return link

    one, other = run(1, 3.0), run(10_000, 0.0003)
    report = one.report()
    assert report == other.report()
    assert report.scene == "paper:1"
    assert report.seconds == pytest.approx(3.0)
    assert report.feedback_lost > 0
    assert report.felt_rmse_n > report.rmse_n > 0
    assert report.round_trip_ms > 1
    assert len(one.slave_samples()["force_n"]) == report.samples
    assert "felt_rmse_n" in repr(report)
    assert "master" not in repr(report).split()


class Ball:
    axes = 3

    def step(self, sample):
        return [100.0 * x for x in sample.position_m]


class Orbit:
    axes = 3

    def sample(self, t_us):
        return 0.01 * np.cos(t_us * 1e-5), 0.01 * np.sin(t_us * 1e-5), 0.0


def test_a_virtual_link_takes_objects_of_the_user_with_three_axes():
    link = hn.virtual_link(scene=Ball(), operator=Orbit(), codec="deadband")
    link.run(seconds=1.0)
    report = link.report()
    assert report.scene == "Ball"
    assert 0 < report.exceed_jnd_fraction + report.packet_rate_reduction < 1
    assert report.felt_rmse_n < 0.1
    samples = link.slave_samples()
    assert samples["force_y_n"] == pytest.approx(100.0 * samples["position_y_m"], abs=1e-6)


def test_a_virtual_link_without_a_session_says_so():
    link = hn.virtual_link(forward="loss=100%")
    link.run(seconds=0.5)
    with pytest.raises(hn.UnavailableError, match=r"no session after 0.5 s of virtual time"):
        link.report()
    with pytest.raises(hn.SettingsError, match="seconds is -1"):
        link.run(seconds=-1)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scene": "nowhere"}, "unknown scene 'nowhere'"),
        ({"scene": 3}, r"scene: has no method step\(sample\)"),
        ({"operator": object()}, r"operator: has no method sample\(t_us\)"),
        ({"feedback": 0.05}, "it must be text, such as 'wifi'"),
    ],
)
def test_a_virtual_link_that_cannot_be_made_is_refused(arguments, message):
    with pytest.raises(hn.SettingsError, match=message):
        hn.virtual_link(**arguments)


@pytest.mark.plain
@pytest.mark.parametrize("half", ["encode", "reconstruct"])
def test_a_codec_that_raises_ends_the_session_with_its_reason(half):
    @dataclasses.dataclass(frozen=True)
    class Fragile(type(hn.make_codec("deadband"))):
        name = "fragile"

        def encoder(self, axes):
            return _broken(super().encoder(axes), half)

        def decoder(self, axes):
            return _broken(super().decoder(axes), half)

    with pytest.raises(ZeroDivisionError):  # in one's own code, with the traceback
        hn.encode(FORCE, codec=Fragile())
    link = hn.virtual_link(scene="paper:1", codec=Fragile())
    with pytest.raises(hn.UnavailableError, match=f"the session ended: .* {half} failed: .*ZeroDivisionError"):
        link.run(seconds=5)


def _broken(inner, half):
    def broken(t_us, *arguments):
        return getattr(inner, half)(t_us, *arguments) if t_us < 1_000_000 else 1 / 0

    names = [name for name in ("encode", "refresh", "decode", "reconstruct") if hasattr(inner, name)]
    return types.SimpleNamespace(**{name: broken if name == half else getattr(inner, name) for name in names})


def test_a_slave_that_grants_few_positions_leaves_the_ticks_of_the_master_alone():
    every, few = (hn.virtual_link(scene="paper:1", fastest_rate_hz=rate_hz) for rate_hz in (10_000.0, 50.0))
    for link in (every, few):
        link.run(seconds=2.0)
    assert len(few.master_samples()["t_us"]) == len(every.master_samples()["t_us"]) == 2000
    assert np.median(np.diff(few.slave_samples()["t_us"])) == 20_000
    with pytest.raises(hn.SettingsError, match="fastest rate"):
        hn.virtual_link(fastest_rate_hz=0.0)
