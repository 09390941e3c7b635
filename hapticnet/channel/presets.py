"""Named networks. Each describes one direction of a link; a round trip passes through two.

Only physical limits are exact. The other numbers are typical of such links, for trying a system on a kind of network;
they are not measurements of one.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from hapticnet.channel.jitter import Jitter
from hapticnet.channel.loss import BernoulliLoss, GilbertElliottLoss
from hapticnet.channel.settings import ChannelSettings

SPEED_OF_LIGHT_KM_PER_S: Final = 299_792.458
"""Speed of light in vacuum, by definition of the metre (SI)."""

FIBRE_GROUP_INDEX: Final = 1.468
"""Group index of single-mode fibre at 1550 nm, typical of data sheets."""

LONDON_NEW_YORK_KM: Final = 5_570.0
"""Great circle from 51.51° N 0.13° W to 40.71° N 74.01° W on a sphere of 6,371 km radius."""

GEOSTATIONARY_ALTITUDE_KM: Final = 35_786.0
"""Altitude above the equator of an orbit with a period of one sidereal day."""

EARTH_RADIUS_KM: Final = 6_378.0
"""Radius at the equator."""

FIBRE_FLOOR_MS: Final = LONDON_NEW_YORK_KM * FIBRE_GROUP_INDEX / SPEED_OF_LIGHT_KM_PER_S * 1e3
"""27.3 ms: propagation time in a fibre along the great circle."""

OVERHEAD_HOP_MS: Final = 2.0 * GEOSTATIONARY_ALTITUDE_KM / SPEED_OF_LIGHT_KM_PER_S * 1e3
"""238.7 ms: up and down with the satellite overhead at both ends."""

HORIZON_HOP_MS: Final = (
    2.0
    * math.sqrt((EARTH_RADIUS_KM + GEOSTATIONARY_ALTITUDE_KM) ** 2 - EARTH_RADIUS_KM**2)
    / SPEED_OF_LIGHT_KM_PER_S
    * 1e3
)
"""278.1 ms: up and down with the satellite on the horizon at both ends."""


@dataclass(frozen=True, slots=True)
class Preset:
    """A named network.

    Attributes
    ----------
    settings
        Its effects, in one direction.
    source
        Source of its numbers.
    """

    settings: ChannelSettings
    source: str


PRESETS: Final[Mapping[str, Preset]] = MappingProxyType(
    {
        "perfect": Preset(ChannelSettings(), "nothing added, nothing lost"),
        "lan": Preset(
            ChannelSettings(
                delay_us=200,
                jitter=Jitter(distribution="normal", deviation_us=50),
                rate_bit_per_s=1_000_000_000,
            ),
            "typical of switched gigabit Ethernet with a few switches and both hosts' network stacks; the rate is "
            "1000BASE-T's",
        ),
        "wifi": Preset(
            ChannelSettings(
                delay_us=2_000,
                jitter=Jitter(distribution="pareto", deviation_us=3_000),
                loss=GilbertElliottLoss(p=0.004, r=0.4),
                rate_bit_per_s=50_000_000,
            ),
            "typical of a shared home or office access point. Losses come in bursts of 2.5 packets, 1 % overall; "
            "two states are a simplification: da Silva and Pedroso, Sensors 22 (2022) 8592, find them inadequate "
            "for measured Wi-Fi losses. Order is kept because 802.11 receivers reorder",
        ),
        "4g": Preset(
            ChannelSettings(
                delay_us=20_000,
                jitter=Jitter(distribution="normal", deviation_us=5_000),
                loss=GilbertElliottLoss(p=0.001, r=0.5),
                rate_bit_per_s=13_600_000,
                queue_us=300_000,
            ),
            "rate and delay after Ofcom's measurements with smartphones in five UK towns, Q4 2014: mean upload "
            "13.6 Mbit/s, mean round trip 53.1 ms (20 ms and a jitter of 6.6 ms on average, twice); spread of the "
            "jitter, loss and queue typical",
        ),
        "transatlantic": Preset(
            ChannelSettings(
                delay_us=35_000,
                jitter=Jitter(distribution="normal", deviation_us=500),
                loss=BernoulliLoss(0.001),
                rate_bit_per_s=100_000_000,
            ),
            f"London to New York: light in fibre along the great circle takes {FIBRE_FLOOR_MS:.1f} ms; the fastest "
            "cable's tested round trip is 58.95 ms (Hibernia Express, 2015); 35 ms, jitter, loss and rate are "
            "typical of routed internet paths",
        ),
        "satellite": Preset(
            ChannelSettings(
                delay_us=290_000,
                jitter=Jitter(distribution="normal", deviation_us=8_000),
                loss=GilbertElliottLoss(p=0.001, r=0.2),
                rate_bit_per_s=5_000_000,
                queue_us=300_000,
            ),
            f"geostationary: {OVERHEAD_HOP_MS:.1f} ms with the satellite overhead to {HORIZON_HOP_MS:.1f} ms on the "
            "horizon, plus ground equipment, for the round trip of about 600 ms that Huston reports (APNIC, 2022); "
            "jitter, loss, rate and queue typical",
        ),
    }
)
