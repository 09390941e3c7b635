"""A study that is malformed is refused in one line that says what would be right."""

from pathlib import Path

import pytest

from hapticnet.codec.registry import every_codec
from hapticnet.documents import parse_document
from hapticnet.errors import HapticnetError
from hapticnet.sweep.plan import Runner, plan_of
from hapticnet.sweep.runs import Cutter, Grid, Shard, overlap
from hapticnet.sweep.study import Study, read_study

CODECS = every_codec()

HEAD = 'name = "x"\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name = ", "not a TOML file: .*line 1"),
        ("seed = 3", "name is missing"),
        (HEAD + "repeat = 3", "unknown key 'repeat' .did you mean 'repeats'"),
        (HEAD + "repeats = 0", "repeats is 0"),
        (HEAD + "seed = -1", "seed is -1"),
        (HEAD + 'axes = "all"', "axes is 'all'; it must be a table"),
        (HEAD + "[axes]\ncodecs = ['raw']", "axes.* 'axes.codecs'|unknown key 'axes.codecs'.*codec"),
        (HEAD + "[axes]\ncodec = []", "at least one value"),
        (HEAD + "[axes]\ncodec = [3]", "text in quotes, and 3 is not"),
        (HEAD + "[axes]\ncodec = 'morse'", "unknown codec 'morse'"),
        (HEAD + "[axes]\nmultiplier = 'two'", "a number, and 'two' is not"),
        (HEAD + "[axes]\nmultiplier = nan", "a number, and nan is not"),
        (HEAD + "[axes]\nmultiplier = -1", "JND multiplier is -1"),
        (HEAD + "[axes]\ndelay = '20'", "is not a time such as 20ms"),
        (HEAD + "[axes]\ndelay = 20", "text in quotes, and 20 is not"),
        (HEAD + "[axes]\nloss = '120%'", "is not a share"),
        (HEAD + "[axes]\nloss = 1.5", "loss probability is 1.5"),
        (HEAD + "[axes]\njitter = '5ms'", "is not a jitter such as normal:5ms"),
        (HEAD + "[axes]\nfeedback = 'wlan'", "is not a preset"),
        (HEAD + "[axes]\nfeedback = 'delay=3ms'\ndelay = '5ms'", '"delay" is given twice'),
        (HEAD + "[axes]\nrepair = 'soon'", "is not a time"),
        (HEAD + "[axes]\nrate_hz = 0", "rate_hz is 0"),
        (HEAD + "[axes]\nscene = 'moon'", "unknown scene 'moon'"),
        (HEAD + "[axes]\nhand = 'robot'", "hand 'robot' must be scripted or palpation"),
        (HEAD + "[axes]\nhand = 'scripted:speed=2'", "there is no 'speed'; there are: start_m"),
        (HEAD + "[axes]\nhand = 'scripted:insertions=two'", "insertions is 'two'; it must be a whole number"),
        (HEAD + "[axes]\nscene = 'phantom'\nhand = 'scripted'", "scene 'phantom': 3; use palpation"),
        (HEAD + "[axes]\nrecording = 'none.csv'", "none.csv: No such file"),
        (HEAD + "[axes]\nrecording = 'none.csv'\nscene = 'paper'", "recording replaces scene"),
        (HEAD + "[axes]\nrecording = 'none.csv'\npredicted = true", "predicted needs a scene"),
        (HEAD + "[axes]\npredicted = []", "at least one value"),
        (HEAD + "[axes]\npredicted = 'maybe'", "axes.predicted"),
        (HEAD + "[reading]\ncolumn = '2'", "axes.recording names none"),
        (HEAD + "[axes.parameters]\nalpha = 0.5", "no codec here has a parameter 'alpha'"),
        (HEAD + "repeats = 100000000\n[axes]\nmultiplier = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]", "runs; at most"),
        (HEAD + "[show]\nbyy = ['codec']", "unknown key 'show.byy'|unknown key 'byy'"),
    ],
)
def test_a_malformed_study_is_refused_with_what_would_be_right(tmp_path, text, message):
    path = tmp_path / "study.toml"
    path.write_text(text)
    with pytest.raises(HapticnetError, match=message) as refused:
        plan_of(read_study(path))
    assert "\n" not in str(refused.value)
    assert "study.toml" in str(refused.value) or "none.csv" in str(refused.value)


def values(axis, text):
    return getattr(parse_document(f"{HEAD}[axes]\n{axis} = {text}", "test", Study).axes, axis)


@pytest.mark.parametrize(
    ("axis", "text", "expected"),
    [
        ("multiplier", "2", [2.0]),
        ("multiplier", "[1, 2, 1]", [1.0, 2.0]),
        ("loss", "[0, 0.02, '5%', 'gilbert:0.01,0.5']", ["none", "2%", "5%", "gilbert:1%,50%,0%,100%"]),
        ("repair", "['round-trip', 'never', '20ms']", ["round-trip", "never", "20ms"]),
    ],
)
def test_an_axis_is_one_value_or_a_list(axis, text, expected):
    assert values(axis, text) == expected


def plan_from(tmp_path: Path, text: str):
    path = tmp_path / "study.toml"
    path.write_text(text)
    return plan_of(read_study(path))


def test_the_fingerprint_changes_with_what_changes_a_number_and_with_nothing_else(tmp_path):
    scene = tmp_path / "scene.toml"
    tissue = '[[tissue]]\nname = "skin"\nrest_position_m = 0.02\nstiffness_n_per_m = 200.0\nbreach_force_n = {}\n'
    scene.write_text('name = "mine"\n' + tissue.format("2.0"))
    text = HEAD + "[axes]\nscene = 'scene.toml'\n"
    digest = plan_from(tmp_path, text).digest
    assert plan_from(tmp_path, text.replace('"x"', '"y"')).digest == digest
    assert plan_from(tmp_path, "repeats = 9\n" + text).digest == digest
    assert plan_from(tmp_path, text + "[show]\nby = ['codec']").digest == digest
    assert plan_from(tmp_path, "seed = 2\n" + text).digest != digest
    assert plan_from(tmp_path, text + "loss = '1%'").digest != digest
    scene.write_text('name = "mine"\n' + tissue.format("3.0"))
    assert plan_from(tmp_path, text).digest != digest


def test_the_raw_codec_has_no_threshold_to_vary_and_parameters_apply_where_they_exist(tmp_path):
    study = (
        HEAD + "[axes]\ncodec = ['raw', 'deadband', 'probabilistic']\nmultiplier = [1, 2]\n"
        "[axes.parameters]\nstep_n = [0.001, 0.01]\n"
    )
    plan = plan_from(tmp_path, study)
    coded = [Runner(plan).settings(cell) for cell in range(plan.cells)]
    assert {each["multiplier"] for each in coded if each["codec"] == "raw"} == {1.0}
    deadband = [each for each in coded if each["codec"] == "deadband"]
    assert {(each["multiplier"], each["parameter_step_n"]) for each in deadband} == {
        (multiplier, step_n) for multiplier in (1.0, 2.0) for step_n in (0.001, 0.01)
    }


def test_a_grid_numbers_every_combination_once_with_the_last_axis_fastest():
    grid = Grid((("a", "b"), (1, 2, 3)))
    assert [grid[cell] for cell in range(len(grid))] == [("a", 1), ("a", 2), ("a", 3), ("b", 1), ("b", 2), ("b", 3)]


def test_what_is_missing_is_cut_without_gaps_and_overlaps():
    there = [Shard(3, 5), Shard(9, 12)]
    cutter = Cutter(there, 20)
    cut = []
    while (shard := cutter.cut(2)) is not None:
        cut.append(shard)
    covered = sorted(run for shard in (*there, *cut) for run in range(shard.first, shard.end))
    assert covered == list(range(20))
    assert max(shard.runs for shard in cut) == 2
    assert cutter.left == 0
    assert overlap([*there, *cut]) is None
    assert overlap([Shard(0, 4), Shard(3, 5)]) == (Shard(0, 4), Shard(3, 5))


STUDIES = sorted((Path(__file__).parents[2] / "studies").glob("*.toml"))


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_the_ready_studies_can_be_planned_and_show_columns_that_exist(path):
    file = read_study(path)
    plan = plan_of(file)
    assert 100 <= plan.runs <= 2000
    show = file.study.show
    assert show.by is not None
    assert {*show.by, *(show.of or ()), show.x, show.y, *(show.line or ()), *(show.panel or ())} <= set(plan.columns)


def test_the_study_of_rate_and_distortion_has_every_codec():
    (path,) = (path for path in STUDIES if path.stem == "rate-distortion")
    assert set(read_study(path).study.axes.codec) == {name for name, codec in CODECS.items() if not codec.renders_model}
