"""``hapticnet slave``: host the scene and answer masters."""

from dataclasses import dataclass

from hapticnet import options
from hapticnet.options import RECORD_LIMIT


@dataclass(frozen=True, slots=True, kw_only=True)
class SlaveOptions:
    """The options of ``hapticnet slave``."""

    listen: options.Listen = "127.0.0.1:47800"
    scene: options.Scene = "paper:0"
    duration: options.Duration = None
    drain: options.Drain = 0.0
    key: options.Key = None
    masters: options.Masters = None
    insecure: options.Insecure = False
    keep: options.Keep = 30.0
    fastest_rate: options.FastestRate = 10_000.0
    most_sessions: options.MostSessions = 64
    most_sessions_per_key: options.MostSessionsPerKey = 16
    announce: options.Announce = "declared"
    add_codec: options.AddCodec = None
    channel_out: options.ChannelOut = "perfect"
    seed: options.Seed = 0
    record_dir: options.RecordDir = None
    record_format: options.RecordFormat = "csv"
    record_limit: options.RecordLimit = RECORD_LIMIT
    metrics: options.Metrics = None
    real_time: options.RealTime = True
    json: options.Json = False
    report: options.Report = None
    quiet: options.Quiet = False


def slave(given: SlaveOptions) -> None:
    """Host the virtual tissues: each master touches its own scene.

    On loopback, anyone is served unless --key or --masters is given. LineDecoder, only the masters of the list are
    served: --key and --masters, by default key.toml and masters.toml in ~/.config/hapticnet.

    Ends on Ctrl-C, SIGTERM or after --duration, and then prints its report. A second signal ends --drain.
    """
    from hapticnet.cli.slave_setup import serve

    serve(given)
