"""``hn.encode``, ``hn.compare``, ``hn.make_codec``: one codec on one recording, or several on several."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from html import escape
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from hapticnet.api.inputs import ForceLike, as_codec, read_trial
from hapticnet.arrays import FloatArray, IntArray
from hapticnet.codec.base import Codec, Encoding
from hapticnet.codec.recording import encode_array
from hapticnet.codec.registry import all_codecs, register_installed_codecs
from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.experiment import comparison
from hapticnet.experiment.comparison import Row, codec_label
from hapticnet.experiment.grid import grid_codecs
from hapticnet.experiment.trials import Trial
from hapticnet.measure.quality import QualityReport, quality_report
from hapticnet.node.offline import cost_report
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION
from hapticnet.recordings.loading import Recording

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes

_SHOWN: Final = (
    "trial", "label", "multiplier", "packets_per_s", "wire_bytes_per_s", "over_optimum", "rmse_n", "max_error_n",
    "exceed_jnd_fraction", "felt_exceed_jnd_fraction",
)  # fmt: skip


class Table:
    """A result shown as a table: as text in a terminal, as HTML in a notebook."""

    __slots__ = ()

    def _table(self) -> tuple[Sequence[str], Sequence[Sequence[Any]]]:
        """Return head and rows."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return _text_table(*self._table())

    def _repr_html_(self) -> str:
        return _html_table(*self._table())


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Report(Table, QualityReport):
    """Cost and quality of a codec on one recording: the fields of `QualityReport`, and those below."""

    codec: str
    """Name of the codec."""
    samples: int
    seconds: float
    """Length of the recording."""
    sent: int
    packet_rate_reduction: float
    packets_per_s: float
    """Samples transmitted; ``1 - sent / samples``; `sent` per second."""
    payload_bytes: int
    """Bytes of all FORCE datagrams."""
    wire_bytes: int
    wire_bytes_per_s: float
    """The same with 28 B of UDP and IPv4 headers each; per second."""
    wire_byte_reduction: float
    """``1 - wire_bytes / (wire bytes when every sample is sent raw)``."""
    keepalives: int
    session_wire_bytes: int
    """Keepalives of a session in which these forces are sent; its wire bytes including them."""

    def _table(self) -> tuple[Sequence[str], list[tuple[str, Any]]]:
        costs_first = dict.fromkeys([*Report.__annotations__, *(field.name for field in fields(self))])
        return ("measure", "value"), [(name, getattr(self, name)) for name in costs_first]


@dataclass(frozen=True, slots=True, kw_only=True, repr=False, eq=False)
class Encoded:
    """Result of encoding and decoding a recording of n samples without loss."""

    codec: Codec
    """The codec object, with its parameters and its law."""
    t_us: IntArray
    """Time stamps [µs], shape (n,)."""
    force: FloatArray
    """The given forces [N], shape (n,) or (n, a) as given."""
    decoded: FloatArray
    """The force that the receiver applies at every sample [N], same shape."""
    sent: IntArray
    """Indices of the transmitted samples, shape (m,)."""
    payload_bytes: npt.NDArray[np.uint16]
    """Size of each transmitted payload [B], shape (m,)."""
    position: FloatArray | None = None
    """Positions of the tool [m], same shape, if given."""

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


class Comparison(Table, list[Row]):
    """Rows of a comparison. `Row` documents the fields, and ``row.flat()`` returns them all in one dictionary."""

    def to_dataframe(self) -> "pandas.DataFrame":
        """Return a pandas DataFrame with a line for each row and a column for each figure of ``row.flat()``.

        Raises
        ------
        UnavailableError
            If pandas is not installed.
        """
        try:
            import pandas
        except ImportError as error:
            raise UnavailableError("to_dataframe() needs pandas: pip install pandas") from error
        return pandas.DataFrame([row.flat() for row in self])

    def _table(self) -> tuple[Sequence[str], list[list[Any]]]:
        return _SHOWN, [[flat[name] for name in _SHOWN] for flat in (row.flat() for row in self)]


def compare(
    force: "ForceLike | Sequence[ForceLike] | Mapping[str, ForceLike]",
    *,
    rate_hz: float | None = None,
    t_s: npt.ArrayLike | None = None,
    t_us: npt.ArrayLike | None = None,
    position: npt.ArrayLike | None = None,
    codecs: str | Codec | Sequence[str | Codec] | None = None,
    multipliers: float | Sequence[float] = (1.0, 2.0, 4.0),
    weber_fraction: float = PAPER_WEBER_FRACTION,
    floor_n: float = PAPER_FLOOR_N,
    loss: float | Sequence[float] = 0.0,
    delay_ms: float = 25.0,
    seed: int = 1,
    jobs: int = 1,
) -> Comparison:
    """Run several codecs over one or more recordings.

    Parameters
    ----------
    force
        As for `encode`; or a dictionary of them by name; or a list of recordings from `load_recording`.
    rate_hz, t_s, t_us, position
        As for `encode`; the same for all entries of a dictionary.
    codecs
        Names with or without parameters, or codec objects; default: all registered codecs. An object has its own law;
        `multipliers`, `weber_fraction` and `floor_n` do not apply to it.
    multipliers
        Thresholds in JNDs, each tried with every codec name. "raw" has no threshold and is tried once.
    weber_fraction, floor_n
        The law of the person; default: 0.05 and 0.025 N, from the paper.
    loss
        Share of updates lost at random (0 to 1), or several; a lost update is repaired after 20 ms.
    delay_ms
        Delay of each way [ms] at which the force that is felt is compared with the true one (0 to 3.6e6).
    seed
        Seed of the losses, which are the same for all codecs.
    jobs
        Number of processes.

    Returns
    -------
    Comparison
        A list with a `Row` for each recording, loss and codec.

    Raises
    ------
    SampleError
        If a recording cannot be used; see `encode`.
    SettingsError
        If a codec or another argument cannot be used.
    """
    times = {"rate_hz": rate_hz, "t_s": t_s, "t_us": t_us, "position": position}
    trials = [read_trial(each, **times, name=name) for name, each in _named(force).items()]  # type: ignore[arg-type]
    if codecs is None:
        register_installed_codecs()
        codecs = list(all_codecs())
    codecs = list(codecs) if isinstance(codecs, Sequence) and not isinstance(codecs, str) else [codecs]
    law = {"multiplier": np.atleast_1d(multipliers).tolist(), "weber_fraction": [weber_fraction], "floor_n": [floor_n]}
    chosen = grid_codecs([codec for codec in codecs if isinstance(codec, str)], law)
    for codec in codecs:
        if not isinstance(codec, str):
            chosen.append(as_codec(codec, weber_fraction=None, floor_n=None, multiplier=None, parameters={}))
    if not chosen:
        raise SettingsError("nothing to compare; give at least one codec and one multiplier")
    for trial in trials:
        if trial.t_us[-1] == trial.t_us[0]:
            raise SettingsError(
                f"{trial.name}: {len(trial.t_us)} samples over no time; at least two at different times are needed"
            )
    return Comparison(
        comparison.compare(trials, chosen, loss=loss, delay_us=round(1e3 * delay_ms), seed=seed, jobs=jobs)
    )


def _named(force: Any) -> dict[str, Any]:
    if isinstance(force, Mapping):
        return {str(name): each for name, each in force.items()}
    if isinstance(force, (list, tuple)) and any(isinstance(each, Recording) for each in force):
        return {f"recording {number}": each for number, each in enumerate(force, start=1)}
    return {"force": force}


def _columns(values: FloatArray) -> FloatArray:
    return values.reshape(len(values), -1)


def _text_table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return rows as aligned text; the first column is left-aligned, numbers have four digits."""
    cells = [list(head), *([_text(value) for value in row] for row in rows)]
    widths = [max(len(row[column]) for row in cells) for column in range(len(head))]
    lines = [
        "  ".join(cell.rjust(width) if column else cell.ljust(width) for column, (cell, width) in enumerate(pairs))
        for pairs in (list(zip(row, widths, strict=True)) for row in cells)
    ]
    return "\n".join(line.rstrip() for line in lines)


def _html_table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return rows as an HTML table."""
    top = "".join(f"<th>{escape(name)}</th>" for name in head)
    body = "".join(f"<tr>{''.join(f'<td>{escape(_text(value))}</td>' for value in row)}</tr>" for row in rows)
    return f"<table><thead><tr>{top}</tr></thead><tbody>{body}</tbody></table>"


def _text(value: Any) -> str:
    if value is None:
        return "–"
    if isinstance(value, float) and math.isfinite(value):
        return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.4g}"
    return str(value)
