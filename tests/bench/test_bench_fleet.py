"""The model of a service keeps the timers of real masters and the limits of real slaves."""

from pathlib import Path

import pytest

from hapticnet.node.reception import ALL_REQUESTS_AT_ONCE, ALL_REQUESTS_PER_S, REQUESTS_AT_ONCE, REQUESTS_PER_S
from hapticnet.protocol.asking import Asking
from hapticnet.protocol.settings import SessionSettings
from hapticnet.runtime.entropy import SystemEntropy

MEASURE = Path(__file__).parents[2] / "bench" / "measure"


@pytest.fixture(scope="module")
def fleet():
    """Return the modules of the model."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(MEASURE)
        import fleet_costs
        import fleet_model
        import fleet_parts

        yield fleet_parts, fleet_model, fleet_costs


def lose_all(fleet, *, answers_s, seconds, **settings):
    parts, model, _ = fleet
    made = model.Model(parts.FleetSettings(**{"masters": 1, "addresses": 1, "sample_s": 0.0} | settings), 1)
    made.seat_all()
    made.fail(made.slaves, answers_s=answers_s)
    made.env.run(seconds)
    return made


def test_hellos_without_an_answer_back_off_as_those_of_a_real_master(fleet):
    asking = Asking(fleet[2].request(1000.0, ""), SessionSettings(), SystemEntropy(), None)
    asking.begin(None)
    real_s = [now_us / 1e6 for now_us in range(0, 20_000_000, 1000) if asking.tick(now_us) is not None]
    made = lose_all(fleet, answers_s=1000.0, seconds=22.0)
    times_s = sorted(made.hellos.elements())
    first_s = times_s[0]
    # Bins are a tenth of a second long, and the real one is looked at each millisecond.
    modelled_s = [0.1 * (each - first_s) for each in times_s if 0.1 * (each - first_s) < 19.8]
    assert len(modelled_s) == pytest.approx(sum(each < 19.8 for each in real_s), abs=1)
    assert modelled_s == pytest.approx(real_s[: len(modelled_s)], abs=0.15)


def test_a_master_asks_after_a_silence_and_is_served_once_somebody_answers(fleet):
    made = lose_all(fleet, answers_s=10.0, seconds=30.0)
    assert made.hellos
    assert min(made.hellos) * 0.1 == pytest.approx(1.2, abs=0.11)
    (away_s,) = made.away
    assert 10.0 < away_s < 11.1


def test_a_slave_that_is_back_at_once_answers_with_reset_before_the_master_asks(fleet):
    made = lose_all(fleet, answers_s=0.3, seconds=30.0)
    (away_s,) = made.away
    assert 0.3 < away_s < 0.4


def test_requests_are_limited_for_an_address_and_for_a_process(fleet):
    one_address = lose_all(fleet, answers_s=0.3, seconds=60.0, masters=48)
    assert max(one_address.away) == pytest.approx(0.3 + (48 - REQUESTS_AT_ONCE) / REQUESTS_PER_S, rel=0.1)
    own_addresses = lose_all(fleet, answers_s=0.3, seconds=60.0, masters=150, addresses=150)
    limit_s = (150 - ALL_REQUESTS_AT_ONCE) / ALL_REQUESTS_PER_S
    assert max(own_addresses.away) == pytest.approx(0.3 + limit_s, rel=0.1)
    assert own_addresses.outcomes["session"] == 150


def test_masters_that_back_off_together_take_longer_than_the_limit_of_a_process(fleet):
    made = lose_all(fleet, answers_s=0.3, seconds=60.0, masters=350, addresses=350)
    limit_s = (350 - ALL_REQUESTS_AT_ONCE) / ALL_REQUESTS_PER_S
    assert max(made.away) > 0.3 + 2 * limit_s, "of HELLOs that come together, few are read"
    assert made.outcomes["session"] == 350


def test_a_slave_without_a_place_refuses_and_the_master_comes_again(fleet):
    made = lose_all(fleet, answers_s=0.3, seconds=60.0, masters=10, addresses=10, seats=8)
    assert (len(made.away), len(made.slaves[0].seated)) == (8, 8)
    assert 2 * 3 <= made.outcomes["refused"] <= 2 * 7  # after 1, 2, 4, 8, 16, 16 s


def test_a_full_queue_drops_hellos_and_they_are_said_again(fleet):
    costs = fleet[0].Costs(cookie_us=5000.0, admit_us=5000.0, queue=4)
    made = lose_all(fleet, answers_s=0.3, seconds=60.0, masters=30, addresses=30, costs=costs)
    assert made.slaves[0].dropped > 0
    assert len(made.away) == 30


def test_masters_of_a_lost_host_spread_over_the_others(fleet):
    parts, model, _ = fleet
    settings = parts.FleetSettings(masters=400, addresses=400, hosts=4, processes=2, detect_s=3.0)
    made = model.Model(settings, 1)
    made.seat_all()
    lost = sum(len(slave.seated) for slave in made.hosts[0].slaves)
    made.fail(made.hosts[0].slaves)
    made.env.run(30.0)
    assert len(made.away) == lost
    assert min(made.away) > 3.0
    assert not any(slave.seated for slave in made.hosts[0].slaves)
