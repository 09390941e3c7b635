"""The law of a participant, as options give it."""

from pathlib import Path

from hapticnet.perception import PAPER_FLOOR_N, PAPER_WEBER_FRACTION, WeberLaw


def law_given(weber: float, floor: float, multiplier: float, law: Path | None) -> WeberLaw:
    """Return the law of a participant's file, or of the numbers given.

    Raises
    ------
    FileError
        If the file cannot be read.
    SettingsError
        If a number cannot be used, or the law is given in both ways.
    """
    if law is None:
        return WeberLaw(weber_fraction=weber, floor_n=floor, multiplier=multiplier)
    from hapticnet.errors import SettingsError
    from hapticnet.study.weber import load_participant

    if (weber, floor) != (PAPER_WEBER_FRACTION, PAPER_FLOOR_N):
        raise SettingsError(f"--law {law} gives the law; leave out --weber and --floor")
    measured = load_participant(law)
    return WeberLaw(weber_fraction=measured.weber_fraction, floor_n=measured.floor_n, multiplier=multiplier)
