"""The figures: lines that coincide, the figure of a run, and that the same data give the same file."""

import pytest

from hapticnet.errors import SettingsError
from hapticnet.experiment.figures import draw_run
from hapticnet.experiment.style import COLOURS, check_format, draw_codecs, picture


def test_lines_that_coincide_are_drawn_once_under_both_names(tmp_path):
    lines = {"deadband": [(1.0, 2.0), (2.0, 1.0)], "merging": [(1.0, 3.0)], "probabilistic": [(1.0, 2.0), (2.0, 1.001)]}
    with picture(tmp_path / "figure.png", 2.0) as figure:
        axes = figure.subplots()
        draw_codecs(axes, lines)
        labels = axes.get_legend_handles_labels()[1]
    assert labels == ["deadband\n= probabilistic", "merging"]
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    "labels", [["deadband", "merging", "level-crossing"], [f"deadband:step_n={n}" for n in range(9)]]
)
def test_no_two_lines_look_the_same(tmp_path, labels):
    with picture(tmp_path / "figure.svg", 2.0) as figure:
        axes = figure.subplots()
        draw_codecs(axes, {label: [(1.0, float(n)), (2.0, float(n))] for n, label in enumerate(labels)})
        looks = {(line.get_color(), line.get_marker(), line.get_linestyle()) for line in axes.get_lines()}
    assert len(looks) == len(labels)
    assert {colour for colour, *_ in looks} <= set(COLOURS)


def test_a_run_is_drawn_even_without_a_breach_and_always_the_same(tmp_path, loopback):
    link = loopback(1, device=True)
    files = [tmp_path / name for name in ("short.png", "run.png", "again.png")]
    for file, duration_us in zip(files, (500_000, 4_500_000, 0), strict=True):
        link.run(duration_us)
        draw_run(link.slave.stations[0].recording.table(), link.master.recording.table(), file)
    assert files[1].read_bytes() == files[2].read_bytes() != files[0].read_bytes()


def test_a_format_that_does_not_exist_is_refused():
    with pytest.raises(SettingsError, match="'gif'; it must be png, pdf or svg"):
        check_format("gif")
