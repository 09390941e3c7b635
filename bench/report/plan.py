"""Every benchmark, with its arguments in a full and in a quick run."""

from typing import Final, Literal, NamedTuple


class Benchmark(NamedTuple):
    """A script of bench/measure, its arguments in full and in a quick run, and the build that it measures."""

    name: str
    full: str
    quick: str
    timed: Literal["", "plain", "compiled"] = ""
    takes_recordings: bool = False
    as_root: bool = False


BENCHMARKS: Final = (
    Benchmark("packet_rate", "", "--seeds 1 --insertions 1"),
    Benchmark("rate_distortion", "--seeds 2 --seconds 10", "--quick", takes_recordings=True),
    Benchmark("repair", "", "--quick"),
    Benchmark("felt", "", "--quick", takes_recordings=True),
    Benchmark("teleoperation", "", "--quick --seeds 1"),
    Benchmark("announced", "", "--quick --seeds 1"),
    Benchmark("stability", "", "--quick"),
    Benchmark("vibration", "", "--seconds 3 --seeds 1"),
    Benchmark("codec_stability", "--seconds 5 --seeds 3", "--quick"),
    Benchmark("force_loop", "--seeds 5", "--quick --seeds 1"),
    Benchmark("finger_limit", "--seeds 2", "--quick --seeds 1"),
    Benchmark("hostile_slave", "--seconds 8", "--quick", timed="plain"),  # seconds of search
    Benchmark("fuzz", "--datagrams 500000", "--datagrams 20000", timed="plain"),
    Benchmark("endurance", "--hours 4 --wrap-hours 0.05", "--hours 0.05 --wrap-hours 0.011"),
    Benchmark("codec_speed", "--samples 2000000 --repetitions 3", "--samples 20000 --repetitions 1", timed="compiled"),
    Benchmark("virtual_time", "", "--insertions 1 --repetitions 2", timed="compiled"),
    Benchmark("real_time", "--seconds 5", "--seconds 0.3 --repetitions 1", timed="compiled"),
    Benchmark("round_trip", "--seconds 3", "--seconds 1 --repetitions 1", timed="compiled"),
    Benchmark(
        "sessions",
        "--seconds 1 --tries 5 --repetitions 2",
        "--quick --seconds 0.4 --repetitions 1 --tries 1",
        timed="compiled",
    ),
    Benchmark("floods", "--seconds 1 --repetitions 2", "--quick --seconds 0.3 --repetitions 1", timed="compiled"),
    Benchmark(
        "peers",
        "--seconds 1 --repetitions 2",
        "--quick --seconds 0.5 --repetitions 1 --no-real-time",
        timed="compiled",
        as_root=True,
    ),
    Benchmark("doors", "", "--quick --seconds 0.5 --repetitions 1 --no-real-time", timed="compiled", as_root=True),
)
