"""The figure of how a participant answered in the measurement of the JND."""

from matplotlib import pyplot as plt

from hapticnet.study.rows import LimitsRow
from hapticnet.study.series_figure import draw_series

ANSWERS = {1.0: ((0.01, "same"), (0.02, "same"), (0.03, "different")), 2.0: ((0.30, "same"), (0.40, "different"))}


def pair(reference_n, series, step, difference_n, answer, **values):
    return LimitsRow(
        event="trial", participant="03", session=1, method="ascending", reference_n=reference_n, series=series,
        step=step, difference_n=difference_n, answer=answer, catch=0, **values,
    )  # fmt: skip


def test_every_pair_of_a_session_is_a_mark_within_its_figure(tmp_path, monkeypatch):
    rows = [
        pair(reference_n, series, step, difference_n, answer)
        for series, (reference_n, answers) in enumerate(ANSWERS.items())
        for step, (difference_n, answer) in enumerate(answers)
    ]
    rows += [pair(1.0, 5, 0, 0.01, "same", observer="literature")]
    seen = []
    monkeypatch.setattr(plt, "close", lambda figure: seen.append(figure))
    files = draw_series(rows, tmp_path)
    assert {file.name for file in files} == {"series-03-1.pdf", "series-03-1.png"}
    assert all(file.stat().st_size > 1000 for file in files)
    panels = seen[-1].axes
    for axes, (reference_n, answers) in zip(panels, ANSWERS.items(), strict=True):
        marks = [line for line in axes.lines if len(line.get_xdata()) == 1 and line.get_marker() != "None"]
        shares = {round(float(line.get_ydata()[0]), 6) for line in marks}
        assert {round(100 * difference_n / reference_n, 6) for difference_n, _ in answers} <= shares
        low, high = axes.get_ylim()
        assert low <= 0.0 < max(shares) <= high, "no mark is cut off"
    assert "SIMULATED" in seen[-1].get_suptitle()


def test_without_an_answer_there_is_no_figure(tmp_path):
    assert draw_series([LimitsRow(event="begin", participant="03", session=1)], tmp_path) == []
