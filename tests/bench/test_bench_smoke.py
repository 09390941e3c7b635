import json

import pytest

from hapticnet.codec.registry import every_codec

CODECS = every_codec()


@pytest.mark.parametrize(
    "arguments",
    [
        ("packet_rate", "--insertions", 0),
        ("rate_distortion", "missing.csv"),
        ("sessions", "--cases", "raw; nothing"),
    ],
)
def test_a_benchmark_refuses_arguments_it_cannot_use_in_one_line(bench, arguments):
    done = bench(f"measure/{arguments[0]}.py", *arguments[1:])
    assert done.returncode == 2
    assert "error:" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


def test_a_benchmark_prints_its_record_if_no_file_is_named(bench):
    done = bench("measure/virtual_time.py", "--insertions", 1, "--repetitions", 1)
    assert json.loads(done.stdout)["name"] == "virtual_time"


def test_virtual_time_answers_positions_in_every_case(measured):
    results = measured("virtual_time")
    cases = results["cases"]
    assert list(cases) == ["no device", "simulated device", "simulated device, wifi", "simulated device, 4g"]
    for figures in cases.values():
        assert 0.0 < figures["times_real_time_median"] <= figures["times_real_time_best"]
        # A position each virtual millisecond, but for those lost, late, or before the session stood.
        assert 0.9 < figures["positions_answered"] / (1000.0 * figures["virtual_s"]) <= 1.0


@pytest.mark.timeout(400)  # it compiles every codec, on a machine that may be busy
def test_codec_speed_measures_every_way_on_the_same_signal(measured):
    results = measured("codec_speed")
    assert results["samples"] == 20_000
    assert [row["sent"] for row in results["rows"]] == pytest.approx([0.01, 0.1, 0.4], abs=0.05)
    for row in results["rows"]:
        assert min(row[way] for way in ("c", "plain", "stream")) > 0.0
    assert [row["codec"] for row in results["codecs"]] == list(CODECS)
    assert all(min(row["walk_ns"], row["paper_ns"]) > 0.0 for row in results["codecs"])
    assert {row["codec"] for row in results["codecs"] if row["c"]} == {"deadband", "adaptive-predictive"}


def test_real_time_measures_hapticnet_beside_its_limits(measured):
    results = measured("real_time")
    for measure, limit in (("tick lateness", "C clock_nanosleep"), ("position to force", "bare UDP echo")):
        cases = ["raw", "raw, sealed", "deadband", "deadband, sealed"]
        assert list(results[measure]) == [limit, *(f"hapticnet, {case}" for case in cases)]
        for percentiles_us in results[measure].values():
            assert len(percentiles_us) == 3
            assert percentiles_us == sorted(percentiles_us)
            assert percentiles_us[-1] > 0.0
    assert list(results["sealed over open"]) == ["raw", "deadband"]
    for plain, sealed in (("raw", "raw, sealed"), ("deadband", "deadband, sealed")):
        for one, other in zip(results["bytes a datagram"][plain], results["bytes a datagram"][sealed], strict=True):
            assert other - one == pytest.approx(16.0, abs=8.0)


def test_force_loop_never_presses_harder_than_the_device_may_and_comes_to_rest(measured):
    rows = measured("force_loop")["largest"]
    assert len({row["scenario"] for row in rows}) == len(rows) / 6 == 15
    for row in rows:
        assert row["at_rest"]
        if row["scenario"] == "sensor frozen, 3 to 5 N":
            # What is under way when a frozen sensor is noticed arrives late; the finger of 3 N/mm feels it.
            assert row["max_n"] <= 5.0 + 0.3 * (row["delay_ms"] > 0)
        elif row["scenario"] != "twice as stiff at 2 N":
            assert row["max_n"] <= 5.0
            assert row["above_limit_ms"] == 0


def test_hostile_datagrams_raise_nothing_and_leave_no_memory_behind(measured):
    rows = measured("fuzz")["rows"]
    nodes = ("slave", "master")
    assert [(row["node"], row["sealed"]) for row in rows] == [
        (node, sealed) for node in nodes for sealed in (False, True)
    ]
    for row in rows:
        assert row["first_exceptions"] == []
        assert row["exceptions"] == row["failures"] == 0
        assert row["sessions_lost"] in (None, 0)
        assert row["memory_growth_mb"] < 20.0
        assert (row["insiders"] > 0) == row["sealed"]
        assert (row["requests"] > 0) == (row["node"] != "master")


def test_floods_are_measured_beside_a_session_at_work_and_newcomers(measured):
    for row in measured("floods")["rows"]:
        assert row["connections"] == 1
        assert 0.0 < row["quiet_p50_us"] <= row["quiet_p99_us"]
        assert 0.0 < row["flooded_p50_us"] <= row["flooded_p99_us"]
        assert row["newcomers"] >= 1
        assert row["newcomers_shut_out"] == 0


def test_sessions_are_measured_beside_an_echo_in_every_kind_of_session(measured):
    rows = measured("sessions")["rows"]
    assert {row["case"] for row in rows} == {"deadband", "raw, sealed", "coded positions"}
    assert {row["server"] for row in rows} == {"echo", "slave"}
    for row in rows:
        assert 0.0 < row["us_per_position"] == pytest.approx(1e6 / row["sends_hz"] / row["sessions_a_core"])
        assert row["why_no_more"] or row["held"]
        (run,) = row["runs"]
        assert run["positions"] > 0
        assert run["answers"] > 0
        assert run["malformed"] == run["refused"] == run["ended"] == 0
        assert run["at_work"] == row["masters"]
        if row["server"] != "echo":
            assert run["closed"] == row["masters"]
            assert run["slave_steps"] > 0
    assert 0.0 < max(row["runs"][0]["greatest_force_n"] for row in rows) < 5.0


def test_a_long_session_ends_as_it_began(measured):
    rows = measured("endurance")["rows"]
    assert [(row["sealed"], row["rate_hz"]) for row in rows] == [
        (False, 50.0),
        (False, 1000.0),
        (True, 50.0),
        (True, 1000.0),
    ]
    assert [row["time_stamp_wraps"] for row in rows] == [0, 1, 0, 1]
    assert [row["sequence_wraps"] for row in rows] == [0, 1, 0, 0]
    for row in rows:
        assert row["connections"] == 1
        assert row["malformed"] == row["stray"] == 0
        assert row["largest_force_n"] > 1.0
        assert row["force_difference_n"] < 1e-6
        assert 20_000 <= row["lag_us"] <= 20_000 + 2e6 / row["rate_hz"], "the delay, and less than two periods"
        assert row["memory_growth_mb"] < 5.0
