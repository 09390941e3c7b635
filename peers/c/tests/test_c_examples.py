"""The examples, over UDP and in real time."""

import pytest

import peer
from conformance.programs import check_felt, check_refused, check_slave, length_test, running_slave


def test_the_example_of_a_master_feels_the_scene_of_a_slave_of_hapticnet(build_folder):
    program = peer.build("examples", build_folder) / "master"
    with running_slave() as port:
        check_felt([program, "127.0.0.1", port, 2])


def test_a_master_of_hapticnet_feels_the_spring_of_the_example_of_a_slave(build_folder):
    check_slave([peer.build("examples", build_folder) / "slave"])


@pytest.mark.parametrize("port", ["x", "99999", "0", "47800x", "-1", ""])
def test_an_example_refuses_a_port_that_is_none_with_its_usage(build_folder, port):
    folder = peer.build("examples", build_folder)
    check_refused([folder / "master", "127.0.0.1", port], "usage: master [")
    check_refused([folder / "slave", port], "usage: slave [")


@pytest.mark.parametrize("seconds", ["x", "0", "-1", "nan", "inf"])
def test_the_example_of_a_master_refuses_a_duration_that_is_none(build_folder, seconds):
    program = peer.build("examples", build_folder) / "master"
    check_refused([program, "127.0.0.1", "47800", seconds], "usage: master [")


test_an_example_is_short_and_its_length_is_in_the_readme = length_test(peer.HERE, "*.c", 60)
