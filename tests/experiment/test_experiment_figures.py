"""The figures: lines that coincide, the figure of a run, and that the same data give the same file."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest
from matplotlib.figure import Figure

from hapticnet.codec.registry import make_codec
from hapticnet.experiment.comparison import compare
from hapticnet.experiment.comparison_figures import Figures
from hapticnet.experiment.signal_figure import draw_run
from hapticnet.experiment.step_response import plot_step
from hapticnet.experiment.style import COLOURS, draw_codecs, finish_axes, legend, picture
from hapticnet.experiment.trials import Trial
from hapticnet.perception import WeberLaw
from tests.ready import ROOT


@pytest.fixture
def drawn(monkeypatch):
    """Return the figures that are written, as they are written."""
    figures = []
    write = Figure.savefig

    def keep(figure, *arguments, **options):
        write(figure, *arguments, **options)
        figures.append(figure)

    monkeypatch.setattr(Figure, "savefig", keep)
    return figures


def check_readable(figure):
    """Check that no legend hides what axes show, and that every logarithmic axis says that it is one."""
    legends = [*figure.legends, *(axes.get_legend() for axes in figure.axes if axes.get_legend())]
    assert legends
    for each in legends:
        box = each.get_window_extent()
        assert not any(axes.get_window_extent().shrunk(0.98, 0.98).overlaps(box) for axes in figure.axes)
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            if axis.get_label_text():
                assert (axis.get_scale() != "linear") == axis.get_label_text().endswith("log scale")


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
        draw_run(link.slave.contexts[0].recording.table(), link.master.recording.table(), file, codec="raw")
    assert files[1].read_bytes() == files[2].read_bytes() != files[0].read_bytes()


def test_the_figures_of_a_comparison_hide_nothing_and_declare_their_scales(tmp_path, drawn):
    t_us = 1000 * np.arange(2000)
    trial = Trial(name="sine", t_us=t_us, stimuli=2.0 + np.sin(t_us * 7e-6)[:, None])
    codecs = [make_codec(name, WeberLaw(multiplier=m), {}) for name in ("deadband", "merging") for m in (1.0, 4.0)]
    Figures([trial], codecs, folder=tmp_path).draw(compare([trial], codecs))
    assert len(drawn) == 3
    for figure in drawn:
        check_readable(figure)
    assert "not drawn" not in drawn[0].get_suptitle()


def test_at_one_threshold_the_optima_have_a_point_and_raw_has_a_line_of_text(tmp_path, drawn):
    t_us = 1000 * np.arange(6000)
    trial = Trial(name="sine", t_us=t_us, stimuli=2.0 + np.sin(t_us * 7e-6)[:, None])
    codecs = [make_codec(name, WeberLaw(), {}) for name in ("raw", "deadband")]
    Figures([trial], codecs, folder=tmp_path).draw(compare([trial], codecs))
    packets, _, signal = drawn
    markers = {line.get_label().partition("\n")[0]: line.get_marker() for line in packets.axes[0].get_lines()}
    assert markers["optimum, hold"] == "+"
    assert markers["optimum, lines"] == "x"
    assert packets.get_suptitle().endswith("\nnot drawn: raw, 1,000 packets/s")
    assert re.fullmatch(r"sine: deadband, threshold 1 JND, [0-9.]+ to [0-9.]+ s of 6 s", signal.get_suptitle())


def test_the_figure_of_a_step_begins_shortly_before_it(tmp_path, drawn):
    t_s = np.arange(-2.5, 2.0, 0.001)
    plot_step(tmp_path / "step.png", t_s, 1.0 * (t_s >= 0), np.clip(5 * t_s, 0.0, 1.0))
    (figure,) = drawn
    assert figure.axes[0].get_xlim()[0] == -0.25
    check_readable(figure)


@pytest.mark.parametrize(("values", "scale"), [((0.13, 0.16, 0.2), "linear"), ((0.02, 0.1, 0.5), "log")])
def test_only_figures_that_span_much_get_a_logarithmic_axis_and_panels_share_it(tmp_path, drawn, values, scale):
    with picture(tmp_path / "panels.png", 2.0) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        for axes, shown in zip(panels, (values[:2], values[1:]), strict=True):
            draw_codecs(axes, {"deadband": [(1.0, shown[0], 0.0, 0.01), (2.0, shown[1], 0.0, 0.01)]})
        finish_axes(*panels)
        panels[0].set_ylabel("error")
        legend(figure, *panels)
    assert [axes.get_yscale() for axes in panels] == [scale, scale]
    assert (scale == "log") == (panels[0].get_ylim()[0] > 0.0)
    check_readable(drawn[0])


def test_legends_and_figures_are_made_by_the_one_style():
    style = ROOT / "hapticnet" / "experiment" / "style.py"
    for file in [
        *(ROOT / "hapticnet").rglob("*.py"),
        *(ROOT / "bench").rglob("*.py"),
        *(ROOT / "extras/experiment").rglob("*.py"),
    ]:
        if file != style:
            assert re.findall(r"\.legend\(|plt\.|pyplot\.subplots", file.read_text()) == [], file


def test_figures_are_drawn_whatever_backend_the_environment_names():
    code = "from hapticnet.experiment.style import pyplot; print(pyplot().get_backend())"
    environment = {**os.environ, "MPLBACKEND": "nonsense"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=False)
    assert done.stdout.strip().lower() == "agg"
