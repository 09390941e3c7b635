"""The examples, over UDP and in real time."""

import peer
from conformance.programs import check_felt, check_slave, length_test, running_slave


def test_the_example_of_a_master_feels_the_scene_of_a_slave_of_hapticnet(build_folder):
    program = peer.build("examples", build_folder) / "master"
    with running_slave() as port:
        check_felt([program, "127.0.0.1", port, 2])


def test_a_master_of_hapticnet_feels_the_spring_of_the_example_of_a_slave(build_folder):
    check_slave([peer.build("examples", build_folder) / "slave"])


test_an_example_is_short_and_its_length_is_in_the_readme = length_test(peer.HERE, "*.c", 60)
