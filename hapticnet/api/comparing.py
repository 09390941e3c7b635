"""``hn.compare``: several codecs on one or more recordings, beside the fewest packets possible."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from hapticnet.api.inputs import ForceLike, as_codec, read_trial
from hapticnet.api.tables import Table
from hapticnet.codec.base import Codec
from hapticnet.codec.registry import all_codecs, register_installed_codecs
from hapticnet.errors import SettingsError, UnavailableError
from hapticnet.experiment import comparison
from hapticnet.experiment.comparison import Row
from hapticnet.experiment.grid import grid_codecs
from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION
from hapticnet.recordings.loading import Recording

if TYPE_CHECKING:
    import pandas

_SHOWN: Final = (
    "trial", "label", "multiplier", "packets_per_s", "wire_bytes_per_s", "over_optimum", "rmse_n", "max_error_n",
    "exceed_jnd_fraction", "felt_exceed_jnd_fraction",
)  # fmt: skip


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
