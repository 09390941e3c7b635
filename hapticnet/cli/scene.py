"""``hapticnet scene``: look at a scene without a network."""

from typing import Annotated, Any

import typer

from hapticnet import options

app = typer.Typer(no_args_is_help=True, help="Look at a scene without a network.")

Spec = Annotated[
    str, typer.Argument(metavar="SCENE", help="paper, paper:SEED, a preset, a TOML file, or FILE.py:CLASS.")
]


@app.command(short_help="Print the tissues or bodies of a scene.")
def show(scene: Spec = "paper:0", json: options.Json = False, report: options.Report = None) -> None:
    """Print the tissues of a scene, from front to back, or its bodies; for your own class, its name and axes."""
    from dataclasses import asdict

    from hapticnet.cli.console import check_outputs, deliver
    from hapticnet.scene.settings import BodySceneSettings
    from hapticnet.scene.sources import UserSource, find_scene, find_source, scene_names

    source = find_source(scene)
    check_outputs(report, inputs=[source.file])
    if isinstance(source, UserSource):
        made = source.make()
        deliver({"name": made.name, "axes": made.axes}, as_json=json, file=report)
        return
    settings = find_scene(scene)
    others: dict[str, Any] = {"follower": asdict(settings.follower)} if settings.follower is not None else {}
    others["other_scenes"] = ", ".join(["paper:SEED", *scene_names()])
    if isinstance(settings, BodySceneSettings):
        bodies = [{key: value for key, value in asdict(body).items() if value != 0.0} for body in settings.bodies]
        account = {"name": settings.name, "axes": settings.axes, "body": bodies}
        deliver({**account, **others}, as_json=json, file=report)
        return
    tissues = []
    for tissue in settings.tissues:
        declared = {key: value for key, value in asdict(tissue).items() if value != 0.0}
        if not tissue.shaft_friction_n:
            del declared["shaft_presliding_m"]  # describes the onset of friction, and there is none
        tissues.append({**declared, "breaches_at_m": tissue.rest_position_m + tissue.breach_depth_m})
    deliver({"name": settings.name, "tissue": tissues, **others}, as_json=json, file=report)
