import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapticnet.channel.settings import (
    LONGEST_US,
    BernoulliLoss,
    ChannelSettings,
    GilbertElliottLoss,
    Jitter,
)
from hapticnet.channel.spec import (
    PRESETS,
    parse_channel,
)
from hapticnet.errors import SettingsError

shares = st.floats(0.0, 1.0)
times_us = st.integers(0, LONGEST_US)
jitters = st.builds(Jitter, distribution=st.sampled_from(["normal", "uniform", "pareto"]), deviation_us=times_us)
losses = st.one_of(
    st.builds(BernoulliLoss, shares),
    st.builds(GilbertElliottLoss, st.floats(1e-9, 1.0), shares, shares, shares),
)
settings_of_every_kind = st.builds(
    ChannelSettings,
    delay_us=times_us,
    jitter=st.none() | jitters,
    loss=st.none() | losses,
    reorder_probability=shares,
    hold_back_us=st.integers(1, LONGEST_US),
    duplicate_probability=shares,
    rate_bit_per_s=st.none() | st.integers(1, 10**12),
    queue_us=st.integers(1, LONGEST_US),
)


@given(settings_of_every_kind)
def test_a_description_is_parsed_back_exactly(settings):
    assert parse_channel(settings.describe()) == settings


def test_every_part_is_understood():
    spec = "delay=20ms,jitter=normal:5ms,loss=2%,reorder=1%:10ms,duplicate=0.1%,rate=1Mbit/s,queue=50ms"
    assert parse_channel(spec) == ChannelSettings(
        delay_us=20_000,
        jitter=Jitter(distribution="normal", deviation_us=5_000),
        loss=BernoulliLoss(0.02),
        reorder_probability=0.01,
        hold_back_us=10_000,
        duplicate_probability=0.001,
        rate_bit_per_s=1_000_000,
        queue_us=50_000,
    )
    assert parse_channel(spec).describe() == spec


@pytest.mark.parametrize(
    ("spec", "loss"),
    [
        ("loss=0.02", BernoulliLoss(0.02)),
        ("loss=57%", BernoulliLoss(0.57)),
        ("loss=gilbert:1%,30%", GilbertElliottLoss(0.01, 0.3)),
    ],
)
def test_both_kinds_of_loss_are_understood(spec, loss):
    assert parse_channel(spec).loss == loss
    assert parse_channel(f"delay=1ms,{spec},queue=3ms") == ChannelSettings(delay_us=1000, loss=loss, queue_us=3000)


@pytest.mark.parametrize(
    ("spec", "settings"),
    [
        (" Delay = 1.5 ms , RATE=9.6kbit/s", ChannelSettings(delay_us=1500, rate_bit_per_s=9600)),
        ("delay=250us", ChannelSettings(delay_us=250)),
        ("delay=.25s", ChannelSettings(delay_us=250_000)),
        ("reorder=5%", ChannelSettings(reorder_probability=0.05, hold_back_us=10_000)),
        ("jitter=Pareto:2ms", ChannelSettings(jitter=Jitter(distribution="pareto", deviation_us=2000))),
        ("PERFECT", ChannelSettings()),
    ],
)
def test_units_are_parsed_in_any_case(spec, settings):
    assert parse_channel(spec) == settings


def test_parts_after_a_preset_replace_its_parts():
    wifi = PRESETS["wifi"]
    assert parse_channel("wifi") == wifi
    lossier = parse_channel("wifi,loss=5%")
    assert lossier.loss == BernoulliLoss(0.05)
    assert (lossier.delay_us, lossier.jitter, lossier.rate_bit_per_s) == (
        wifi.delay_us,
        wifi.jitter,
        wifi.rate_bit_per_s,
    )
    without = "satellite,delay=none,jitter=none,loss=none,reorder=none,duplicate=none,rate=none,queue=none"
    assert parse_channel(without) == ChannelSettings()


@pytest.mark.parametrize(
    ("spec", "names", "allows"),
    [
        ("", '""', "perfect, lan, wifi, 4g, transatlantic, satellite"),
        ("wifi,", '""', "delay, jitter, loss, reorder, duplicate, rate, queue"),
        ("delay=1ms,wifi", '"wifi"', "delay, jitter, loss, reorder, duplicate, rate, queue"),
        ("delay=1ms,delay=2ms", '"delay"', "given twice, as 1ms and 2ms"),
        ("delay=20", '"20"', "us, ms or s"),
        ("delay=-5ms", '"-5ms"', "up to 3600s"),
        ("delay=1e300ms", '"1e300ms"', "up to 3600s"),
        ("delay=١ms", '"١ms"', "us, ms or s"),
        ("loss=101%", '"101%"', "from 0% to 100%"),
        ("loss=burst:3", '"burst:3"', "gilbert:p,r"),
        ("loss=gilbert:1%", '"gilbert:1%"', "gilbert:p,r"),
        ("loss=gilbert:0,0", "p and r", "never change"),
        ("loss=" + "2" * 10_000, '"222', "from 0% to 100%"),
        ("jitter=5ms", '"5ms"', "normal:5ms, uniform:5ms or pareto:5ms"),
        ("jitter=normal:5ms:3", '"normal:5ms:3"', "normal:5ms, uniform:5ms or pareto:5ms"),
        ("reorder=1%:0ms", "hold_back_us is 0", "between 1 and"),
        ("rate=1Mbps", '"1mbps"', "bit/s, kbit/s, Mbit/s or Gbit/s"),
        ("rate=2Tbit/s", '"2tbit/s"', "up to 1000Gbit/s"),
    ],
)
def test_a_bad_part_is_named_with_what_is_allowed_in_one_line(spec, names, allows):
    with pytest.raises(SettingsError) as caught:
        parse_channel(spec)
    message = str(caught.value)
    assert message.startswith("channel: ")
    assert names in message
    assert allows in message
    assert "\n" not in message
    assert len(message) < 300


@given(st.text(alphabet="delayjitrosnc=,:%.0123456789+-e/Mµb "))
def test_any_text_is_parsed_or_refused(text):
    try:
        settings = parse_channel(text)
    except SettingsError:
        return
    assert parse_channel(settings.describe()) == settings


@pytest.mark.parametrize("value", [-1, math.nan, math.inf, 1e300])
@pytest.mark.parametrize(
    "name", ["delay_us", "reorder_probability", "hold_back_us", "duplicate_probability", "rate_bit_per_s", "queue_us"]
)
def test_values_out_of_range_are_refused_by_name(name, value):
    with pytest.raises(SettingsError, match=name):
        ChannelSettings(**{name: value})


@pytest.mark.parametrize("value", [-1, math.nan, math.inf, 1e300])
def test_jitter_and_losses_out_of_range_are_refused(value):
    with pytest.raises(SettingsError, match="deviation"):
        Jitter(distribution="normal", deviation_us=value)
    with pytest.raises(SettingsError, match="probability"):
        BernoulliLoss(value)
    with pytest.raises(SettingsError, match="r is"):
        GilbertElliottLoss(0.5, value)


def test_only_known_distributions_exist():
    with pytest.raises(SettingsError, match="one of normal, uniform, pareto"):
        Jitter(distribution="cauchy", deviation_us=1)  # type: ignore[arg-type]


def test_only_a_channel_that_does_nothing_is_perfect():
    for spec in ("perfect", "loss=0%", "jitter=normal:0ms", "queue=1ms"):
        assert parse_channel(spec).is_perfect
    for spec in ("delay=1us", "jitter=normal:1us", "loss=1%", "reorder=1%", "duplicate=1%", "rate=1Gbit/s"):
        assert not parse_channel(spec).is_perfect


def test_presets_are_ordered_by_delay_and_slower_than_light():
    delays_us = [settings.delay_us for settings in PRESETS.values()]
    assert delays_us == sorted(delays_us)
    for name, settings in PRESETS.items():
        assert parse_channel(name) == parse_channel(settings.describe()) == settings
    light_km_per_ms, group_index = 299.792458, 1.468
    radius_km, altitude_km = 6378.0, 35_786.0
    horizon_km = 2.0 * math.sqrt((radius_km + altitude_km) ** 2 - radius_km**2)
    assert PRESETS["transatlantic"].delay_us >= 1e3 * 5570.0 * group_index / light_km_per_ms
    assert PRESETS["satellite"].delay_us >= 1e3 * horizon_km / light_km_per_ms
