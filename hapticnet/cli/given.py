"""The options of ``hapticnet slave`` and ``hapticnet master``; their code is imported when they begin."""

from dataclasses import dataclass

from hapticnet import options
from hapticnet.options import INSERTIONS, RECORD_LIMIT, SharedMasterOptions, SharedSlaveOptions
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION


@dataclass(kw_only=True)
class ProcessOptions:
    """The options that both verbs have."""

    key: options.Key = None
    channel_out: options.ChannelOut = "perfect"
    seed: options.Seed = 0
    record_limit: options.RecordLimit = RECORD_LIMIT
    metrics: options.Metrics = None
    real_time: options.RealTime = True
    json: options.Json = False
    report: options.Report = None
    quiet: options.Quiet = False


@dataclass(kw_only=True)
class SlaveOptions(SharedSlaveOptions, ProcessOptions):
    """The options of ``hapticnet slave``."""

    scene: options.Scene = "paper:0"
    duration: options.Duration = None
    drain: options.Drain = 0.0
    masters: options.Masters = None
    keep: options.Keep = 30.0
    fastest_rate: options.FastestRate = 10_000.0
    add_codec: options.AddCodec = None
    record_dir: options.RecordDir = None
    record_format: options.RecordFormat = "csv"


@dataclass(kw_only=True)
class MasterOptions(SharedMasterOptions, ProcessOptions):
    """The options of ``hapticnet master``."""

    connect: options.Connect = "127.0.0.1:47800"
    operator: options.Operator = None
    insertions: options.Insertions = INSERTIONS
    frame: options.Frame = None
    offset: options.Offset = None
    device: options.Device = "sim"
    profile: options.Profile = None
    duration: options.SessionDuration = None
    codec: options.Codec = "deadband"
    weber: options.Weber = PAPER_WEBER_FRACTION
    floor: options.Floor = PAPER_FLOOR_N
    law: options.Law = None
    multiplier: options.Multiplier = 1.0
    rate: options.Rate = 1000.0
    max_age: options.MaxAge = 1.0
    channel_in: options.ChannelIn = "perfect"
    page: options.Page = None
    connect_timeout: options.ConnectTimeout = None
    record: options.Record = None
