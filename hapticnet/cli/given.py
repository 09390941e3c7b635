"""The options of ``hapticnet slave`` and ``hapticnet master``; what these do is imported when they begin."""

from dataclasses import dataclass

from hapticnet import options
from hapticnet.options import INSERTIONS, POSITION_SHARE, RECORD_LIMIT
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION


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


@dataclass(frozen=True, slots=True, kw_only=True)
class MasterOptions:
    """The options of ``hapticnet master``."""

    connect: options.Connect = "127.0.0.1:47800"
    key: options.Key = None
    peer_key: options.PeerKey = None
    insecure: options.Insecure = False
    operator: options.Operator = None
    insertions: options.Insertions = INSERTIONS
    device: options.Device = "sim"
    profile: options.Profile = None
    duration: options.SessionDuration = None
    codec: options.Codec = "deadband"
    weber: options.Weber = PAPER_WEBER_FRACTION
    floor: options.Floor = PAPER_FLOOR_N
    law: options.Law = None
    multiplier: options.Multiplier = 1.0
    rate: options.Rate = 1000.0
    name: options.Name = "master"
    max_age: options.MaxAge = 1.0
    channel_out: options.ChannelOut = "perfect"
    channel_in: options.ChannelIn = "perfect"
    page: options.Page = None
    device_takes: options.DeviceTakes = "x"
    announced: options.Announced = False
    positions: options.Positions = "raw"
    position_share: options.PositionShare = POSITION_SHARE
    passive: options.Passive = False
    first_touch: options.FirstTouch = False
    seed: options.Seed = 0
    connect_timeout: options.ConnectTimeout = None
    record: options.Record = None
    record_limit: options.RecordLimit = RECORD_LIMIT
    metrics: options.Metrics = None
    real_time: options.RealTime = True
    json: options.Json = False
    report: options.Report = None
    quiet: options.Quiet = False
