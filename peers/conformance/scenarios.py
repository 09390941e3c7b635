"""What happens in the sessions of the suite: networks, codecs, outages, restarts, closes, wraps; open and sealed."""

from collections.abc import Callable
from functools import partial
from typing import Any, Final

import msgpack

from conformance.scenes import TISSUES, Soft, tissue
from conformance.session import ENTRY, KEY, NETWORKS, OTHER_ENTRY, SHARED, SHARING, Scenario, Session
from hapticnet.protocol.messages import Code
from hapticnet.protocol.settings import SessionSettings

Play = Callable[[Session], None]
SLOW: Final = ("near the end", "too slow")


def run(seconds: float) -> Play:
    """Let only time pass."""
    return lambda session: session.run(seconds)


def outage(seconds: float, **ways: bool) -> Play:
    """Close the network for some time."""

    def play(session: Session) -> None:
        session.run(1.0)
        session.shut(seconds, **ways)
        session.run(seconds + 2.5)

    return play


def restart(session: Session) -> None:
    session.run(1.0)
    session.restart()
    session.run(2.0)


def closed_by_the_slave(session: Session) -> None:
    session.run(1.0)
    session.end("moved")
    session.run(1.0)


def failure_of_the_slave(session: Session) -> None:
    session.run(1.0)
    session.end("broken", code=Code.FAILED)
    session.run(1.0)


def closed_by_the_master(session: Session) -> None:
    session.run(1.0)
    session.close()


def closed_without_a_network(session: Session) -> None:
    session.run(0.5)
    session.shut(9.0)
    session.close()


def refused(session: Session) -> None:
    session.restart(axes=1)
    session.run(1.0)


def stopping_slave(session: Session) -> None:
    """Let a slave stop: it is asked again later, and its notice is kept."""
    session.loop.slave.drain(session.loop.now_us)
    session.run(4.0)
    session.restart()
    session.run(8.0)
    session.loop.slave.drain(session.loop.now_us)
    session.loop.slave.check(session.loop.now_us)
    session.run(1.0)


def wraps(session: Session) -> None:
    session.run(0.2)
    session.number(2**32 - 500)
    session.run(2.0)


def jumps(session: Session) -> None:
    for jump_us in (-300_000, 40_000, -5_000_000, 30_000_000, 0):
        session.run(0.7)
        session.jump(jump_us)


def epoch_of_the_master(session: Session) -> None:
    """Let the keys of the master's direction change."""
    session.run(0.5)
    session.number(2**20 - 300)
    session.run(1.0)
    assert session.recorder.session._stream.seal.send_epoch == 1


def epochs(session: Session) -> None:
    """Let the keys of both directions change."""
    session.run(0.5)
    (context,) = session.loop.slave.contexts
    context.session._sequence = 2**20 - 20
    for sequence in (2**20 - 300, 2**21 - 300):
        session.number(sequence)
        session.run(0.7)
    seal = session.recorder.session._stream.seal
    assert (seal.send_epoch, seal.receive_epoch) == (2, 1)


def forged(session: Session) -> None:
    """Let datagrams without the keys arrive, and copies of a genuine one with a changed bit, but of the same kind.

    How a kind is counted that no master takes is left open.
    """
    session.run(1.0)
    genuine = session.feedback.log[-1][1]
    number = msgpack.unpackb(genuine)[2]
    bodies = (b"", bytes(15), bytes(16), bytes(200), msgpack.packb(["forged", 6]))
    wrong = [
        msgpack.packb([version, kind, number, 1 << 20, body])
        for kind in (5, 6, 7, 10)
        for body in bodies
        for version in (1, 2)
    ]
    wrong += [genuine[:at] + bytes([genuine[at] ^ 1]) + genuine[at + 1 :] for at in range(3, len(genuine))]
    for data in wrong:
        session.recorder.receive_datagram(data, session.loop.now_us)
    session.run(0.5)


CODECS: Final = {
    "raw": {}, "raw in counts": {"step_n": 0.001}, "deadband": {}, "deadband in counts": {"step_n": 0.002},
    "probabilistic": {}, "merging": {}, "level-crossing": {}, "linear-predictive": {}, "adaptive-predictive": {},
    "least-squares in counts": {"step_n": 0.001}, "velocity-adaptive": {}, "motion-predictive": {},
    "model-mediated": {}, "passive-extrapolative": {}, "passive-interpolative": {},
}  # fmt: skip


def felt(network: str) -> float:
    """Return the least force that must be felt over a network."""
    return 0.0 if network in SLOW else 3.0


def _scenarios() -> dict[str, Scenario]:
    """Return the sessions for a master of a peer."""
    sessions: dict[str, Scenario] = {}
    for network in NETWORKS:
        for axes in (1, 3):
            least_n = 0.0 if network == "too slow" else 3.0
            sessions[f"{network}, axes {axes}"] = Scenario(play=run(4.0), network=network, axes=axes, least_n=least_n)
        sessions[f"sealed, {network}"] = Scenario(play=run(2.5), network=network, key=KEY, least_n=felt(network))
    for name, parameters in CODECS.items():
        codec = name.split(" ")[0]
        sessions[f"codec {name}"] = Scenario(
            play=run(3.0), network="lossy", codec=codec, parameters=parameters, axes=2, least_n=3.0
        )
    for seconds, ways in (
        (0.25, {}), (0.9, {}), (0.9, {"forward": False}), (0.9, {"back": False}), (3.0, {}), (3.0, {"forward": False}),
        (3.0, {"back": False}), (8.0, {}),
    ):  # fmt: skip
        name = f"silence of {seconds} s{''.join(f', not {way}' for way in ways)}"
        sessions[name] = Scenario(play=outage(seconds, **ways), network="lossy", least_n=3.0)
    for rate_hz in (20.0, 300.0, 997.3, 4000.0):
        slave = {"fastest_rate_hz": 700.0}
        sessions[f"{rate_hz:g} Hz, 700 at most"] = Scenario(
            play=run(2.0), network="lossy", rate_hz=rate_hz, slave=slave, least_n=0.5
        )
    first = {"session": SessionSettings(first_sequence=2**32 - 60)}
    return sessions | {
        "silence at 100 Hz": Scenario(play=outage(1.3), network="slow", rate_hz=100.0),  # a COOKIE with an answer
        "restart of the slave": Scenario(play=restart, network="slow", least_n=3.0),
        "close of the slave": Scenario(play=closed_by_the_slave, network="disorder", least_n=3.0),
        "failure of the slave": Scenario(play=failure_of_the_slave, network="slow"),
        "close of the master": Scenario(play=closed_by_the_master, network="lossy"),
        "close without a network": Scenario(play=closed_without_a_network),
        "refused axes": Scenario(play=refused, axes=3),
        "stopping slave": Scenario(play=stopping_slave, network="slow", least_n=3.0),
        "wraps of both numbers": Scenario(play=wraps, network="disorder", slave=first, least_n=3.0, also=("sequence",)),
        "wrap of the slave's numbers": Scenario(play=run(2.0), network="disorder", slave=first, least_n=3.0),
        "clock that jumps": Scenario(play=jumps, network="slow"),
        "sealed, a shared key": Scenario(play=run(1.5), network="lossy", key=SHARED, masters=(SHARING,), least_n=3.0),
        "sealed, not listed": Scenario(play=run(1.0), network="slow", key=SHARED, masters=(OTHER_ENTRY,)),
        "sealed, listed without the shared key": Scenario(play=run(1.0), network="slow", key=SHARED, masters=(ENTRY,)),
        "sealed, epochs": Scenario(play=epochs, network="disorder", key=KEY, least_n=3.0, also=("sequence",)),
        "sealed, forged datagrams": Scenario(play=forged, network="slow", key=KEY, least_n=3.0),
    }


def _of_slaves() -> dict[str, Scenario]:
    """Return the sessions for a slave of a peer."""
    sessions: dict[str, Scenario] = {}
    for network in NETWORKS:
        sessions[network] = Scenario(play=run(3.0), network=network, least_n=felt(network))
        sessions[f"sealed, {network}"] = Scenario(play=run(2.0), network=network, key=KEY, least_n=felt(network))
    for codec in ("raw", "deadband"):
        for parameters in ({}, {"step_n": 0.001}):
            for axes in (2, 3):
                name = f"{codec}{' in counts' if parameters else ''}, axes {axes}"
                sessions[name] = Scenario(
                    play=run(2.0), network="bursts", codec=codec, parameters=parameters, axes=axes, least_n=3.0
                )
    return sessions | {
        "silence": Scenario(play=outage(2.5), network="lossy", least_n=3.0),
        "restart": Scenario(play=restart, network="slow", least_n=3.0),
        "close of the master": Scenario(play=closed_by_the_master, network="lossy"),
        "wrap of the master's numbers": Scenario(play=wraps, network="disorder", least_n=3.0),
        "sealed, a shared key": Scenario(
            play=run(1.5), network="lossy", key=SHARED, masters=(OTHER_ENTRY, SHARING), least_n=3.0
        ),
        "sealed, not listed": Scenario(play=run(1.0), network="slow", key=KEY, masters=(OTHER_ENTRY,)),
        "sealed, an epoch of the master": Scenario(play=epoch_of_the_master, network="disorder", key=KEY, least_n=3.0),
    }


FEW: Final = {"positions": "line"}
AHEAD: Final = {"announced": True}
PREDICTED: Final = {"predicted": True}
NEEDS: Final = {"positions": "share", "announced": "announced", "predicted": "predicted"}
"""What a peer must have for a setting."""


def against_delay(
    play: Play,
    asked: dict[str, Any],
    network: str = "lossy",
    codec: str = "deadband",
    *,
    scene: Callable[[int], Any] = Soft,
    also: tuple[str, ...] = (),
    **more: Any,
) -> Scenario:
    """Return a session whose master asks for few positions, announced contact or a predicted hand."""
    needs = (*(NEEDS[name] for name in asked), *also)
    more = {"least_n": felt(network), **more}
    return Scenario(play=play, network=network, codec=codec, scene=scene, asked=asked, also=needs, **more)


def _against_delay() -> dict[str, Scenario]:
    """Return the sessions for a master that can ask for few positions, announced contact or predicted hands."""
    sessions: dict[str, Scenario] = {}
    for i, network in enumerate(NETWORKS):
        for name, asked in (("few positions", FEW), ("announced", AHEAD)):
            sessions[f"{name}, {network}"] = against_delay(run(2.5), asked, network, axes=1 + i % 3)
    for name, parameters in CODECS.items():
        codec = name.split(" ")[0]
        sessions[f"few positions, {name}"] = against_delay(run(1.5), FEW, codec=codec, parameters=parameters, axes=2)
    for codec in ("deadband", "motion-predictive", "model-mediated"):
        sessions[f"few positions, announced, {codec}"] = against_delay(run(1.5), FEW | AHEAD, codec=codec, axes=2)
        sessions[f"predicted, {codec}"] = against_delay(run(1.5), PREDICTED, codec=codec, axes=2)
    for kind in TISSUES:
        for name, asked in (("few positions", FEW), ("announced", AHEAD)):
            sessions[f"{name}, {kind} tissue"] = against_delay(
                run(1.5), asked, "disorder", "motion-predictive", scene=partial(one_axis, kind), least_n=1.4
            )
    first = {"session": SessionSettings(first_sequence=2**32 - 60)}
    for name, asked in (("few positions", FEW), ("announced", AHEAD)):
        sessions |= {
            f"{name}, silence": against_delay(outage(2.5), asked),
            f"{name}, silence of a moment": against_delay(outage(0.25, forward=False), asked),
            f"{name}, restart": against_delay(restart, asked, "slow"),
            f"{name}, close of the slave": against_delay(closed_by_the_slave, asked, "disorder"),
            f"{name}, wraps": against_delay(wraps, asked, "disorder", slave=first, also=("sequence",)),
            f"{name}, clock that jumps": against_delay(jumps, asked, "slow", least_n=0.0),
            f"{name}, sealed": against_delay(run(2.0), asked, "disorder", key=KEY),
            f"{name}, 700 Hz at most": against_delay(
                run(1.5), asked, rate_hz=997.3, slave={"fastest_rate_hz": 700.0}, least_n=0.5
            ),
        }
    return sessions


def one_axis(kind: str, _axes: int) -> Any:
    """Return tissues that break, on one axis."""
    return tissue(kind)


MASTERS: Final = _scenarios()
SLAVES: Final = _of_slaves()
AGAINST_DELAY: Final = _against_delay()
