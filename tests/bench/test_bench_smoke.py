import json

import pytest

from hapticnet.codec.registry import every_codec

CODECS = every_codec()

RATES_HZ = [50.0, 100.0, 200.0, 500.0, 1000.0, 2000.0, 5000.0]
CONDITIONS = ["none", "1 JND", "2 JND", "4 JND"]


def test_packet_rate_keeps_the_laws_of_the_deadband_at_every_rate(measured):
    results = measured("packet_rate")
    assert [(row["rate_hz"], row["condition"]) for row in results["scene"]] == [
        (rate_hz, condition) for rate_hz in RATES_HZ for condition in CONDITIONS
    ]
    for start in range(0, len(results["scene"]), 4):
        rows = results["scene"][start : start + 4]
        assert [row["penetrations"] for row in rows] == [3] * 4
        assert rows[0]["packets"] == rows[0]["samples"]
        assert rows[0]["byte_reduction"] == 0.0
        assert rows[1]["exceed_jnd_fraction"] == 0.0
        reductions = [row["byte_reduction"] for row in rows]
        assert reductions == sorted(reductions)
        assert all(0.0 < row["rmse_n"] < row["max_error_n"] for row in rows[1:])


def test_packet_rate_agrees_with_both_nodes_in_virtual_time(measured):
    results = measured("packet_rate")
    assert [row["condition"] for row in results["check"]] == CONDITIONS
    for row in results["check"]:
        assert row["samples_difference"] == row["packets_difference"] == row["rmse_n_difference"] == 0
        # Keepalives take sequence numbers, and in so short a run those grow by two bytes a packet at most.
        assert 0.0 <= row["bytes_per_penetration_mean_difference"] <= 2 * row["packets"] / 3


def test_packet_rate_says_where_the_papers_reduction_falls(measured):
    results = measured("packet_rate")
    assert results["paper_byte_reduction"] == 0.617
    for curve in [*results["over_speeds"], results["without_floor"]]:
        crossing_hz = curve["crossing_hz"]
        assert crossing_hz is None or RATES_HZ[0] < crossing_hz <= RATES_HZ[-1]


@pytest.mark.parametrize(
    "arguments",
    [
        ("packet_rate", "--insertions", 0),
        ("packet_rate", "--seeds", 0),
        ("rate_distortion", "missing.csv"),
        ("rate_distortion", "--seconds", 0),
        ("force_loop", "--seeds", 0),
        ("sessions", "--cases", "raw; nothing"),
        ("scene_accuracy", "--trials", 0),
    ],
)
def test_a_benchmark_refuses_arguments_it_cannot_use_in_one_line(bench, arguments):
    done = bench(f"measure/{arguments[0]}.py", *arguments[1:])
    assert done.returncode == 2
    assert "error:" in done.stderr.splitlines()[-1]
    assert "Traceback" not in done.stderr


def test_a_benchmark_prints_its_record_if_no_file_is_named(bench):
    done = bench("measure/scene_cost.py", "--repetitions", 1)
    assert json.loads(done.stdout)["name"] == "scene_cost"


def test_virtual_time_answers_positions_in_every_case(measured):
    results = measured("virtual_time")
    cases = results["cases"]
    assert list(cases) == ["no device", "simulated device", "simulated device, wifi", "simulated device, 4g"]
    for figures in cases.values():
        assert 0.0 < figures["times_real_time_median"] <= figures["times_real_time_best"]
        # A position each virtual millisecond, but for those lost, late, or before the session stood.
        assert 0.9 < figures["positions_answered"] / (1000.0 * figures["virtual_s"]) <= 1.0


def test_scene_cost_measures_every_case(measured):
    results = measured("scene_cost")
    assert results
    for cases in results.values():
        assert cases
        assert all(0.0 < times_ns["best"] <= times_ns["median"] for times_ns in cases.values())


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


def test_codec_stability_finds_every_codec_in_step_and_repaired(measured):
    results = measured("codec_stability")
    assert all(row["in_step"] for row in results["signals"])
    assert {row["codec"] for row in results["signals"]} == {row["codec"] for row in results["loss"]}
    for row in results["loss"]:
        assert (row["recoveries"] > 0) == (row["recovery_ms_max"] > 0.0) == (row["recovery_ms_median"] > 0.0)
        assert row["loss"] > 0.0 or row["recoveries"] == 0
    assert all(row["samples"] >= 100_000 and row["times_out_of_step"] == 0 for row in results["long"])


def test_force_loop_measures_the_step_on_every_finger(measured):
    results = measured("force_loop")
    assert results["device"] == "sim"
    assert [row["stiffness_n_m"] for row in results["step"]] == [300.0, 1000.0, 3000.0]
    for row in results["step"]:
        # One of three servos by 8 µs: 0.8° of a 12 mm arm, which stands up to 30° off level.
        assert 0.048e-3 < row["servo_step_m"] < 0.056e-3
        assert row["steady_bound_n"] >= 0.5 * row["servo_step_n"]
        assert row["trace"]["t_s"][0] == pytest.approx(-0.1, abs=2e-3)
        assert len({len(column) for column in row["trace"].values()}) == 1
        for force in ("sensed", "true"):
            assert 0.03 < row[force]["rise_s"]["median"] <= row[force]["rise_s"]["worst"] <= 0.2
            assert row[force]["overshoot"]["worst"] < 0.1
    usual = results["step"][1]["true"]
    assert usual["settling_s"]["worst"] <= 0.35
    assert max(usual["steady_error_n"]["worst"], usual["ripple_peak_to_peak_n"]["worst"]) <= 0.05


def test_force_loop_measures_every_control_rate(measured):
    rows = measured("force_loop")["rates"]
    assert [row["rate_hz"] for row in rows] == [25, 100, 500]
    assert rows[1]["cpu_ratio"] == 1.0
    assert all(row["cpu_us_per_s"] > 0.0 for row in rows)
    slow, _, fast = (row["fingers"][1] for row in rows)
    assert fast["true"]["settling_s"]["median"] < slow["true"]["settling_s"]["median"]
    assert fast["sensed"]["ripple_peak_to_peak_n"]["median"] > slow["sensed"]["ripple_peak_to_peak_n"]["median"]


def test_force_loop_has_its_margins_beside_the_observed_edge(measured):
    rows = measured("force_loop")["edges"]
    assert [row["delay_ms"] for row in rows] == [0, 40]
    for row in rows:
        # The linear model leaves out how frames, control periods and readings fall together.
        assert 0.6 * row["frozen"]["gain"] < row["linear_edge"] < 1.2 * row["frozen"]["gain"]
        assert 1.0 < row["hunts_from"] <= row["swings_from"]
    assert rows[1]["linear_edge"] < rows[0]["linear_edge"]


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


def test_finger_limit_puts_the_chain_between_the_limit_and_what_it_was(measured):
    results = measured("finger_limit")
    (ideal,) = results["ideal"]
    before, untold, told = results["loop"]
    assert ideal["limit"] < told["rmse_n"] < ideal["without_the_future"] < untold["rmse_n"] < before["rmse_n"]
    assert told["of_limit"] < 1.9
    for row in results["loop"]:
        assert sum(row["shares"].values()) == pytest.approx(1.0)
        assert row["largest_n"] <= 5.0
    assert before["shares"]["until_first_touch"] > 0.1


def test_rate_distortion_puts_every_codec_beside_the_optimum(measured):
    results = measured("rate_distortion")
    assert {row["codec"] for row in results["rows"]} == set(CODECS)
    assert all(0 < row["optimum_lines"] <= row["optimum_holds"] for row in results["rows"])
    within = [row for row in results["rows"] if row["multiplier"] <= 1.0 and not row["loss"]]
    assert {row["exceed_jnd_fraction"] for row in within if row["codec"] == "deadband"} == {0.0}


def test_scene_accuracy_approaches_the_exact_breach_as_the_rate_grows(measured):
    results = measured("scene_accuracy")
    late_ms = [row["late_mean_ms"] for row in results["breaches"]]
    assert late_ms == sorted(late_ms, reverse=True)
    assert all(row["largest_force_n"] <= results["breach_force_n"] for row in results["breaches"])


def test_repair_is_compared_with_the_same_link_without_loss(measured):
    rows = {(row["repair"], row["loss"], row["clock"], row["delay_us"]): row for row in measured("repair")["rows"]}
    for delay_us in (0, 100_000):
        without = rows["no repair", 0.0, "datagrams", delay_us]
        assert (without["exceed_by_loss"], without["more_bytes"], without["lost_updates"]) == (0.0, 0.0, 0)
        for clock in ("datagrams", "ms"):
            lossy = rows["no repair", 0.1, clock, delay_us]
            assert lossy["exceed_by_loss"] > 0.0
            assert lossy["more_feedback_bytes"] < 0.0
            assert rows["all", 0.1, clock, delay_us]["exceed_by_loss"] <= lossy["exceed_by_loss"]


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


def test_felt_measures_every_codec_with_and_without_delay(measured):
    results = measured("felt")
    rows = results["rows"]
    assert {row["codec"] for row in rows} == set(CODECS)
    assert {row["kind"] for row in rows} == {"paper's scene", "other scenes", "three axes"}
    raw = {(row["signal"], row["delay_ms"]): row for row in rows if row["codec"] == "raw"}
    for (_, delay_ms), row in raw.items():
        late = delay_ms > 0  # without delay, float32 payloads round
        assert (row["exceed_jnd_fraction"] > 0.0, row["rmse_n"] > 1e-6, row["created_share"] > 1e-6) == (late,) * 3
    assert {row["exceed_jnd_fraction"] for row in rows if row["codec"] == "deadband" and not row["delay_ms"]} == {0.0}
    assert all(row["active_share"] <= row["created_share"] + 0.01 for row in raw.values())
    assert {row["codec"] for row in results["means"]} == set(CODECS)


def test_positions_cost_a_fraction_of_raw_ones_and_are_felt_as_well(measured):
    raw, few, raw_late, few_late = measured("positions")["rows"]
    assert (raw["share"], raw_late["share"]) == (None, None)
    for every, some in ((raw, few), (raw_late, few_late)):
        assert some["bytes_per_s"] < 0.08 * every["bytes_per_s"]
        assert some["positions_per_s"] < 60.0
        assert some["exceed_jnd_fraction"] < every["exceed_jnd_fraction"] + 0.02
        assert some["breaches"] == every["breaches"] == 0.0
