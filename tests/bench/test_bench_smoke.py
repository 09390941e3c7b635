import json

import pytest


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
