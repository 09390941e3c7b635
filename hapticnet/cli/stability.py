"""``hapticnet stability``: whether a late force makes a hand swing on a grounded device, by delay and stiffness."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from hapticnet import options

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hapticnet.experiment.stability import Outcome, Setup

CURES: Final[tuple[dict[str, Any], ...]] = ({"codec": "motion-predictive"}, {"coupling": "energy-bounded"})
WALLS: Final = "100,200,500,1000,2000"
LEGEND: Final = """\
stable: it swings less than 0.2 mm; settles: it swings less and less. A share, such as 70%: of the true stiffness, where
a person feels the difference. A distance or a force: it swings for ever, by so much; thrown: by more than 100 mm."""


def stability(
    hand: Annotated[
        str, typer.Option(metavar="HAND[,KEY=VALUE…]", help="Hand and device, as for master --operator hand:HAND.")
    ] = "arm",
    codec: options.Codec = "deadband",
    coupling: options.Coupling = "direct",
    announced: options.Announced = False,
    predicted: options.Predicted = False,
    rate: options.Rate = 1000.0,
    scene: Annotated[str | None, typer.Option(metavar="SCENE", help="Press this scene, instead of walls.")] = None,
    walls: Annotated[str, typer.Option(metavar="N/M[,N/M…]", help="Stiffnesses to press.")] = WALLS,
    delays: Annotated[
        str, typer.Option(metavar="TIME[,TIME…]", help="Round trips of the link.")
    ] = "0ms,10ms,20ms,50ms,100ms,200ms",
    loss: Annotated[str, typer.Option(metavar="PERCENT", help="Share of datagrams lost each way, such as 5%.")] = "0",
    jitter: Annotated[str, typer.Option(metavar="TIME", help="Standard deviation of the delay each way.")] = "0ms",
    seed: options.Seed = 0,
    jobs: options.Jobs = None,
    json: options.Json = False,
    plot: Annotated[Path | None, typer.Option(metavar="FILE", help="Draw the map: .png, .pdf or .svg.")] = None,
    overwrite: options.Overwrite = False,
) -> None:
    """Press tissues over links with a hand that yields, in virtual time, and say where it would swing for ever.

    For devices that push the hand, such as a Haply, omega, Phantom or a leader arm: there, a late force feeds energy
    back. Devices that only press on the skin do not need it.
    """
    import os
    from dataclasses import asdict
    from itertools import product

    from hapticnet.channel.settings import BernoulliLoss, ChannelSettings, parse_jitter, parse_share, parse_time_us
    from hapticnet.cli.console import Console, check_new, check_outputs, deliver, show
    from hapticnet.codec.registry import parse_codec
    from hapticnet.errors import SettingsError
    from hapticnet.experiment.stability import Setup, draw_map, outcomes, word
    from hapticnet.experiment.style import check_format, pyplot
    from hapticnet.experiment.table import print_table
    from hapticnet.measure.stability import NOTICED_S
    from hapticnet.node.settings import MasterSettings
    from hapticnet.operator.yielding import parse_hand
    from hapticnet.scene.sources import find_source

    spec = parse_hand(f"hand:{hand}")
    if spec.motion or spec.axes not in (None, 1):
        raise SettingsError(f"--hand {hand}: omit axes and motion, because the hand presses on one axis")
    if scene is not None and walls != WALLS:
        raise SettingsError("--walls are pressed instead of a --scene; give one of them")
    name, parameters = parse_codec(codec)
    try:
        stiffnesses = [None] if scene is not None else [float(each) for each in walls.split(",")]
    except ValueError:
        raise SettingsError(f"--walls {walls!r} must be stiffnesses in N/m, such as 100,500") from None
    setup = Setup(
        hand=spec.hand,
        device=spec.device,
        master=MasterSettings(
            codec=name, parameters=parameters, coupling=coupling, announced=announced, predicted=predicted, rate_hz=rate
        ),
        channel=ChannelSettings(loss=BernoulliLoss(parse_share(loss)), jitter=parse_jitter(f"normal:{jitter}")),
        scene=None if scene is None else find_source(scene),
        seed=seed,
    )
    round_trips_s = [1e-6 * parse_time_us(each) for each in delays.split(",")]
    if plot is not None:
        check_format(plot.suffix[1:])
        pyplot()
    check_outputs(plot)
    check_new(plot, overwrite=overwrite)
    processes = jobs or len(os.sched_getaffinity(0))
    cells, found, console = list(product(stiffnesses, round_trips_s)), [], Console("stability", quiet=json)
    for each in outcomes(setup, cells, jobs=processes):
        found.append(each)
        console.progress(f"{len(found)} of {len(cells)} presses")
    told = _verdict(setup, found, processes)
    latest_s = max(round_trips_s)
    if noticed := [f"{what} from {1e3 * from_s:g} ms on" for what, from_s in NOTICED_S.items() if from_s <= latest_s]:
        told.append(f"People begin to notice the delay of {', of '.join(noticed)}.")
    console.finish()
    if plot is not None:
        draw_map(plot, found, title=f"{hand}; {codec}; {coupling}")
        console.say(f"picture: {plot}")
    if json:
        rows = [asdict(each) | {"transparent": each.transparent} for each in found]
        account = {"hand": hand, "codec": codec, "coupling": coupling, "presses": rows, "verdict": told}
        deliver(account, as_json=True, file=None)
        return
    head = ["round trip", *("scene" if each is None else f"{each:g} N/m" for each in stiffnesses)]
    print_table(head, [
        [f"{1e3 * delay_s:g} ms", *(word(each) for each in found if each.round_trip_s == delay_s)]
        for delay_s in round_trips_s
    ])  # fmt: skip
    show("\n".join([LEGEND, *told]))


def _verdict(setup: "Setup", found: "Sequence[Outcome]", jobs: int) -> list[str]:
    """Return what a map means, and what would help, which is tried."""
    from dataclasses import replace

    from hapticnet.experiment.stability import outcomes

    bad = [(each.stiffness_n_per_m, each.round_trip_s) for each in found if not each.stable]
    true = sum(each.transparent for each in found)
    if not bad:
        rest = "" if true == len(found) else f"; the other {len(found) - true} feel wrong"
        return [f"This hand holds all of them, and {true} of {len(found)} feel as stiff as they are{rest}."]
    first_s = min(delay_s for _, delay_s in bad)
    softest = min(stiffness or 0.0 for stiffness, delay_s in bad if delay_s == first_s)
    alone = setup.expected(first_s)
    against = f" against {softest:g} N/m" if softest else ""
    first = (
        f"At {1e3 * first_s:g} ms this hand swings for ever{against}. Without codec and coupling it would against"
        f" {alone.stiffness_n_per_m:,.0f} N/m and more, at {alone.frequency_hz:.2g} Hz."
    )
    tried = []
    for cure in (*CURES, CURES[0] | CURES[1]):
        changes: dict[str, Any] = {"parameters": {} if "codec" in cure else setup.master.parameters, **cure}
        changed = replace(setup, master=replace(setup.master, **changes))
        if changed.master != setup.master:
            cured = list(outcomes(changed, bad, jobs=jobs))
            text = " ".join(f"--{key} {value}" for key, value in cure.items())
            tried.append((sum(each.stable for each in cured), sum(each.transparent for each in cured), text))
    held, right, text = max(tried, key=lambda each: each[:2], default=(0, 0, ""))
    if not held:
        return [first, "No other codec or coupling that was tried helps; more damping or less delay would."]
    return [first, f"With {text} it holds {held} of these {len(bad)}, and {right} feel as stiff as they are."]
