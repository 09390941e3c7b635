"""Where a late force makes a hand swing: onsets beside their closed forms, and codecs and couplings over bad links.

Every press runs in virtual time through the real nodes; see hapticnet/experiment/stability.py.
"""

import argparse
import math
import multiprocessing
import os
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from typing import Any, Final

import record

from hapticnet.channel.settings import BernoulliLoss, ChannelSettings, parse_jitter
from hapticnet.codec.registry import every_codec, parse_codec
from hapticnet.control.couplings import COUPLINGS, all_couplings, register_installed_couplings
from hapticnet.errors import SettingsError
from hapticnet.experiment.stability import Setup, outcomes, press
from hapticnet.measure.stability import onset
from hapticnet.node.settings import MasterSettings
from hapticnet.operator.yielding import HANDS, GroundedSettings

Row = dict[str, Any]

# The closed form knows no reflex.
LINEAR: Final = {name: (replace(hand, reflex_n_per_m=0.0), GroundedSettings()) for name, hand in HANDS.items()} | {
    "arm on a device of 0.3 kg": (HANDS["arm"], GroundedSettings(mass_kg=0.3, damping_n_s_per_m=1.0))
}
ONSET_DELAYS_MS: Final = (0, 5, 10, 20, 30, 50, 75, 100, 150, 200)

OURS: Final = (
    ("raw", "direct"),
    ("deadband", "direct"),
    ("motion-predictive", "direct"),
    ("deadband", "energy-bounded"),
    ("motion-predictive", "energy-bounded"),
)
"""Codecs and couplings that are always measured; the deadband also with every other coupling, as in its papers."""
LITERATURE: Final = (("model-mediated", "direct"), ("model-mediated:gain=10", "energy-bounded"))
"""A codec that is a coupling in itself, as published; and one that learns faster, within our bound."""
TABLE_HANDS: Final = ("arm", "tired-arm", "finger")
LINKS: Final = {
    "clean": ChannelSettings(),
    "5 % loss, 5 ms of jitter": ChannelSettings(loss=BernoulliLoss(0.05), jitter=parse_jitter("normal:5ms")),
}
STIFFNESSES: Final = (100.0, 200.0, 500.0, 1000.0, 2000.0)
DELAYS_MS: Final = (0, 20, 50, 100, 200)


def onset_of(setup: Setup, round_trip_s: float, low: float, high: float, *, within: float = 0.01) -> float:
    """Return the stiffness [N/m] between two at which the hand begins to swing, by bisection with real nodes.

    The lower bound if the hand swings there, and infinity if it does not at the upper one.
    """

    def holds(stiffness: float) -> bool:
        return press(setup, stiffness, round_trip_s, gentle=True).stable

    if not holds(low):
        return low
    if holds(high):
        return math.inf
    while high > low * (1.0 + within):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return math.sqrt(low * high)


def found_onset(pair: tuple[str, int]) -> Row:
    """Return where a hand begins to swing at a round trip, by search, and by both closed forms."""
    name, delay_ms = pair
    hand, device = LINEAR[name]
    setup = Setup(hand=hand, device=device, master=MasterSettings(codec="raw"))
    exact = setup.expected(1e-3 * delay_ms)
    continuous = onset(
        hand.mass_kg + device.mass_kg,
        hand.damping_n_s_per_m + device.damping_n_s_per_m,
        hand.stiffness_n_per_m,
        1e-3 * (delay_ms + 1.5),  # a tick until a force is applied, and half of the one in which it is held
    )
    found = onset_of(setup, 1e-3 * delay_ms, exact.stiffness_n_per_m / 1.5, exact.stiffness_n_per_m * 1.5)
    return {
        "hand": name,
        "delay_ms": delay_ms,
        "found_n_per_m": found,
        "sampled_n_per_m": exact.stiffness_n_per_m,
        "continuous_n_per_m": continuous.stiffness_n_per_m,
        "frequency_hz": exact.frequency_hz,
        "off_sampled": found / exact.stiffness_n_per_m - 1.0,
        "off_continuous": found / continuous.stiffness_n_per_m - 1.0,
    }


def table_row(case: tuple[str, str, str, str, Sequence[float], Sequence[int], int]) -> Row:
    """Return the map of a codec, a coupling, a hand and a link, and its summary."""
    codec, coupling, hand, link, stiffnesses, delays_ms, seed = case
    row: Row = {"codec": codec, "coupling": coupling, "hand": hand, "link": link}
    try:
        name, parameters = parse_codec(codec)
        master = MasterSettings(codec=name, parameters=parameters, coupling=coupling)
    except SettingsError as error:
        return row | {"refused": str(error)}
    setup = Setup(hand=HANDS[hand], master=master, channel=LINKS[link], seed=seed)
    found = list(outcomes(setup, list(product(stiffnesses, (1e-3 * each for each in delays_ms)))))
    seconds = sum(each.forward_packets for each in found) / master.rate_hz
    return row | {
        "refused": None,
        "presses": len(found),
        "stable": sum(each.stable for each in found),
        "transparent": sum(each.transparent for each in found),
        "worst_swing_m": max(each.swing_m for each in found),
        "largest_at_rest_n": max((each.largest_n for each in found if each.stable), default=0.0),
        "feedback_packets_per_s": sum(each.feedback_packets for each in found) / seconds,
        "bytes_per_s": sum(each.forward_bytes + each.feedback_bytes for each in found) / seconds,
        "cells": [
            {
                "stiffness_n_per_m": each.stiffness_n_per_m,
                "delay_ms": 1e3 * each.round_trip_s,
                "stable": each.stable,
                "transparent": each.transparent,
                "swing_m": each.swing_m,
                "stiffness_share": each.stiffness_share,
                "lag_s": each.lag_s,
            }
            for each in found
        ],
    }


def measure(arguments: argparse.Namespace) -> Row:
    """Run all searches and all maps, in several processes."""
    register_installed_couplings()
    stiffnesses, delays_ms = ((100.0, 1000.0), (50,)) if arguments.quick else (STIFFNESSES, DELAYS_MS)
    links = list(LINKS)[-1:] if arguments.quick else list(LINKS)
    hands = TABLE_HANDS[:1] if arguments.quick else TABLE_HANDS
    pairs = [("arm", 50)] if arguments.quick else list(product(LINEAR, ONSET_DELAYS_MS))
    cases = [*OURS, *(("deadband", each) for each in all_couplings() if each not in COUPLINGS)]
    cases += LITERATURE if "model-mediated" in every_codec() else []
    tries = [
        (*case, hand, link, stiffnesses, delays_ms, arguments.seed) for case, hand, link in product(cases, hands, links)
    ]
    with multiprocessing.Pool(min(2, os.cpu_count() or 1)) as pool:
        onsets = pool.map(found_onset, pairs, chunksize=1)
        rows = pool.map(table_row, tries, chunksize=1)
    return {
        "hands": hands,
        "stiffnesses": stiffnesses,
        "delays_ms": delays_ms,
        "links": links,
        "cases": cases,
        "onsets": onsets,
        "rows": rows,
    }


def main() -> None:
    parser = record.options(__doc__)
    parser.add_argument("--seeds", type=record.within(1, 1), default=1, help="1: each press is jerked alike")
    parser.add_argument("--quick", action="store_true", help="one onset and one link only, to try the benchmark")
    record.run(parser, measure, unit="as in each name; shares")


if __name__ == "__main__":
    main()
