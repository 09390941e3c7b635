import sys
from pathlib import Path
from subprocess import run

import pytest

from hapticnet.errors import SettingsError
from hapticnet.samples import PositionSample
from hapticnet.scene.sources import find_scene, make_scene, paper_scene, parse_scene, scene_names


def test_the_papers_scene_has_its_three_breach_forces_in_the_order_of_the_seed() -> None:
    orders = {tuple(tissue.breach_force_n for tissue in paper_scene(seed).tissues) for seed in range(60)}
    assert len(orders) == 6
    assert {tuple(sorted(order)) for order in orders} == {(2.0, 3.5, 5.0)}
    assert paper_scene(7) == paper_scene(7)


@pytest.mark.parametrize("seed", range(6))
def test_each_of_the_papers_tissues_breaches_at_half_the_distance_to_the_next(seed: int) -> None:
    tissues = paper_scene(seed).tissues
    assert [tissue.rest_position_m for tissue in tissues] == pytest.approx([0.02, 0.04, 0.06])
    assert [tissue.breach_depth_m for tissue in tissues] == pytest.approx([0.01, 0.01, 0.01])


def test_the_papers_tissues_have_no_other_properties() -> None:
    assert not any(tissue.depends_on_time or tissue.shaft_friction_n for tissue in paper_scene(0).tissues)


def test_a_scene_is_found_by_name_seed_or_path(tmp_path: Path) -> None:
    assert find_scene("paper") == paper_scene(0)
    assert find_scene("paper:12") == paper_scene(12)
    path = tmp_path / "mine.toml"
    path.write_text(
        'name = "mine"\n[[tissue]]\nname = "a"\nrest_position_m = 0\nstiffness_n_per_m = 1\nbreach_force_n = 1\n'
    )
    assert find_scene(str(path)).name == "mine"


@pytest.mark.parametrize("name", scene_names())
def test_every_preset_makes_a_scene_of_its_name(name: str) -> None:
    settings = find_scene(name)
    assert settings.name == name
    made = make_scene(settings)
    assert made.name == name
    assert made.step(PositionSample(0, (-1.0,) * made.axes)).force_n == (0.0,) * made.axes


def test_the_scenes_of_the_documentation_can_be_read() -> None:
    page = Path(__file__).parents[2] / "docs" / "use" / "scenes.md"
    examples = [block.split("```")[0] for block in page.read_text(encoding="utf-8").split("```toml\n")[1:]]
    assert [make_scene(parse_scene(example, "hill.toml")).axes for example in examples] == [1, 3]


@pytest.mark.parametrize("spec", ["paper:", "paper:x", "paper:-1", "paper:1.5", "paper:" + "9" * 5000])
def test_a_seed_that_is_not_a_whole_number_is_refused(spec: str) -> None:
    with pytest.raises(SettingsError, match="seed"):
        find_scene(spec)


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(SettingsError, match="-1"):
        paper_scene(-1)


def test_the_papers_scene_does_not_import_pydantic() -> None:
    code = "import hapticnet.scene.sources as p, sys; p.find_scene('paper'); print('pydantic' in sys.modules)"
    assert run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "False\n"
