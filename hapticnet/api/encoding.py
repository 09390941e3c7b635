"""``hn.encode`` and ``hn.make_codec``: one codec on one recording."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from hapticnet.api.inputs import ForceLike, as_codec, read_trial
from hapticnet.api.tables import Table
from hapticnet.arrays import FloatArray, IntArray
from hapticnet.codec.base import Codec, Encoding
from hapticnet.codec.recording import encode_array
from hapticnet.errors import UnavailableError
from hapticnet.experiment.comparison import codec_label
from hapticnet.experiment.trial import Trial
from hapticnet.measure.quality import QualityReport, quality_report
from hapticnet.node.offline import cost_report

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Report(Table, QualityReport):
    """Cost and quality of a codec on one recording: the fields of `QualityReport`, and those below.

    Attributes
    ----------
    codec
        Name of the codec.
    samples, seconds
        Length of the recording.
    sent, packet_rate_reduction, packets_per_s
        Samples transmitted; ``1 - sent / samples``; `sent` per second.
    payload_bytes
        Bytes of all FORCE datagrams.
    wire_bytes, wire_bytes_per_s
        The same with 28 B of UDP and IPv4 headers each; per second.
    wire_byte_reduction
        ``1 - wire_bytes / (wire bytes when every sample is sent raw)``.
    keepalives, session_wire_bytes
        Keepalives of a session in which these forces are sent; its wire bytes including them.
    """

    codec: str
    samples: int
    seconds: float
    sent: int
    packet_rate_reduction: float
    packets_per_s: float
    payload_bytes: int
    wire_bytes: int
    wire_bytes_per_s: float
    wire_byte_reduction: float
    keepalives: int
    session_wire_bytes: int

    def _table(self) -> tuple[Sequence[str], list[tuple[str, Any]]]:
        costs_first = dict.fromkeys([*Report.__annotations__, *(field.name for field in fields(self))])
        return ("measure", "value"), [(name, getattr(self, name)) for name in costs_first]


@dataclass(frozen=True, slots=True, kw_only=True, repr=False, eq=False)
class Encoded:
    """Result of encoding and decoding a recording of n samples without loss.

    Attributes
    ----------
    codec
        The codec object, with its parameters and its law.
    t_us
        Time stamps [µs], shape (n,).
    force
        The given forces [N], shape (n,) or (n, a) as given.
    decoded
        The force that the receiver applies at every sample [N], same shape.
    sent
        Indices of the transmitted samples, shape (m,).
    payload_bytes
        Size of each transmitted payload [B], shape (m,).
    position
        Positions of the tool [m], same shape, if given.
    """

    codec: Codec
    t_us: IntArray
    force: FloatArray
    decoded: FloatArray
    sent: IntArray
    payload_bytes: npt.NDArray[np.uint16]
    position: FloatArray | None = None

    def report(self) -> Report:
        """Return all costs and errors."""
        force, decoded = _columns(self.force), _columns(self.decoded)
        position = None if self.position is None else _columns(self.position)
        trial = Trial(name="force", t_us=self.t_us, stimuli=force)
        encoding = Encoding(self.sent, decoded, self.payload_bytes)
        cost = cost_report(self.codec, self.t_us, force, encoding)
        quality = quality_report(self.codec.law, self.t_us, force, decoded, self.sent, position)
        known = {
            **asdict(cost),
            **asdict(quality),
            "codec": self.codec.name,
            "seconds": trial.seconds,
            "packets_per_s": cost.sent / trial.seconds,
            "wire_bytes_per_s": cost.wire_bytes / trial.seconds,
        }
        return Report(**{field.name: known[field.name] for field in fields(Report)})

    def plot(self, *, window_s: tuple[float, float] | None = None) -> "list[Axes]":
        """Draw force, sent samples and error over time in a new pyplot figure; return its three axes.

        Parameters
        ----------
        window_s
            The stretch to draw, in seconds after the first sample; default: everything.

        Raises
        ------
        SettingsError
            If the stretch does not begin within the recording.
        UnavailableError
            If matplotlib is not installed.
        """
        try:
            from matplotlib import pyplot
        except ImportError as error:
            raise UnavailableError("plot() needs matplotlib (extra plot): pip install matplotlib") from error
        from hapticnet.experiment.signal_figure import Signal, check_window, fill_figure
        from hapticnet.experiment.style import PRINT_WIDTH_IN, SETTINGS

        t_s = (self.t_us - self.t_us[0]) / 1e6
        signal = Signal(
            t_s=t_s,
            true_n=_columns(self.force),
            applied_n=_columns(self.decoded),
            sent=self.sent,
            lost=self.sent[:0],
            law=self.codec.law,
        )
        if window_s is None:
            window_s = (0.0, float(t_s[-1]))
        else:
            check_window(window_s, "the recording", float(t_s[-1]))
        with pyplot.rc_context(SETTINGS):
            figure = pyplot.figure(figsize=(PRINT_WIDTH_IN, 4.4), layout="constrained")
            fill_figure(figure, signal, window_s=window_s, title=codec_label(self.codec))
        return list(figure.axes)

    def __repr__(self) -> str:
        return f"<Encoded: {self.codec.name}, {len(self.sent)} of {len(self.t_us)} samples sent>"


def make_codec(
    codec: str | Codec = "deadband",
    *,
    weber_fraction: float | None = None,
    floor_n: float | None = None,
    multiplier: float | None = None,
    **parameters: float,
) -> Codec:
    """Return a codec, from which ``encoder(axes)`` and ``decoder(axes)`` make the two halves of a stream.

    Parameters
    ----------
    codec
        A name that ``hapticnet codecs`` lists, ``"name:key=value,…"``, ``"FILE.py:Class"``, ``"package.module:Class"``,
        or a codec object.
    weber_fraction, floor_n, multiplier
        The law of the person: the threshold is ``multiplier · max(weber_fraction · |force|, floor_n)``. Default: 0.05,
        0.025 N and 1, from the paper.
    **parameters
        The codec's own parameters; ``hapticnet codecs`` lists them.

    Raises
    ------
    SettingsError
        If the codec or a parameter is unknown or out of range.
    """
    return as_codec(codec, weber_fraction=weber_fraction, floor_n=floor_n, multiplier=multiplier, parameters=parameters)


def encode(
    force: ForceLike,
    *,
    rate_hz: float | None = None,
    t_s: npt.ArrayLike | None = None,
    t_us: npt.ArrayLike | None = None,
    position: npt.ArrayLike | None = None,
    codec: str | Codec = "deadband",
    weber_fraction: float | None = None,
    floor_n: float | None = None,
    multiplier: float | None = None,
    **parameters: float,
) -> Encoded:
    """Encode and decode a recording as slave and master do when nothing is lost.

    Parameters
    ----------
    force
        Forces [N], shape (n,) or (n, a) with 1 to 3 axes, positive when they push the tool out of the tissue: a list,
        array, pandas Series or DataFrame; or a recording from `load_recording`, which has its own times.
    rate_hz, t_s, t_us
        Sampling rate [Hz], or the time of each sample in seconds or microseconds, shape (n,): at most one of them.
        Default: 1000 Hz.
    position
        Positions of the tool [m], growing into the tissue, same shape as `force`.
    codec, weber_fraction, floor_n, multiplier, **parameters
        See `make_codec`.

    Raises
    ------
    SampleError
        If a value is not finite, lengths differ, times run backwards, or the sample period is implausible.
    SettingsError
        If the codec, a parameter or the rate cannot be used, or times are given twice.
    """
    chosen = make_codec(codec, weber_fraction=weber_fraction, floor_n=floor_n, multiplier=multiplier, **parameters)
    trial = read_trial(force, rate_hz=rate_hz, t_s=t_s, t_us=t_us, position=position)
    encoding = encode_array(chosen, trial.t_us, trial.stimuli, trial.positions)
    shape = trial.stimuli.shape
    if np.ndim(force) == 1:  # type: ignore[arg-type]  # a recording has none
        shape = shape[:1]
    return Encoded(
        codec=chosen,
        t_us=trial.t_us,
        force=trial.stimuli.reshape(shape),
        decoded=encoding.decoded.reshape(shape),
        sent=encoding.sent,
        payload_bytes=encoding.payload_bytes,
        position=None if trial.positions is None else trial.positions.reshape(shape),
    )


def _columns(values: FloatArray) -> FloatArray:
    return values.reshape(len(values), -1)
