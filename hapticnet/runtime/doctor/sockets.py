"""Socket buffers, and datagrams that the kernel dropped."""

import socket
from typing import Final

from hapticnet.runtime.doctor.finding import Figures, Finding, Step, Topic, Verdict, size
from hapticnet.runtime.doctor.machine import Machine
from hapticnet.runtime.udp import RECEIVE_BUFFER_BYTES, SEND_BUFFER_BYTES

SUBJECT: Final = "network"

CHARGED_BYTES: Final = 832
"""What a datagram of some 30 bytes takes of a receive buffer, its bookkeeping included (measured: Linux 6, x86-64).

Linux grants twice what is asked for, because of this bookkeeping (socket(7))."""

MOST_DROPPED: Final = 0.001
"""Share of received datagrams that may have been dropped since boot."""


def examine_sockets(machine: Machine) -> list[Finding]:
    """Return the findings about buffers and drops."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        granted = []
        for option, asked in ((socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES), (socket.SO_SNDBUF, SEND_BUFFER_BYTES)):
            sock.setsockopt(socket.SOL_SOCKET, option, asked)
            granted.append(sock.getsockopt(socket.SOL_SOCKET, option))
    return [
        judge_buffer("receive", granted[0], machine.container),
        judge_buffer("send", granted[1], machine.container),
        judge_drops(machine),
    ]


def judge_buffer(direction: str, granted: int, container: str | None) -> Finding:
    """Judge a buffer by what the kernel says it granted [B], which is twice the net size."""
    asked = RECEIVE_BUFFER_BYTES if direction == "receive" else SEND_BUFFER_BYTES
    net, datagrams = granted // 2, granted // CHARGED_BYTES
    figures: Figures = {"asked_bytes": asked, "granted_bytes": net, "datagrams": datagrams}
    topic = Topic(SUBJECT, f"{direction}_buffer", f"{direction.capitalize()} buffer", figures)
    if net >= asked:
        return topic.ok(f"{size(net)}, as asked for; holds {datagrams} datagrams")
    setting = f"net.core.{'r' if direction == 'receive' else 'w'}mem_max={asked}"
    meaning = "When the network is slower than the sender, datagrams are lost early."
    if direction == "receive":
        meaning = (
            f"It overflows if a slave stands still for {datagrams} ms with one master at 1 kHz, or {datagrams // 10} ms"
            " with ten."
        )
    return topic.find(
        Verdict.WARNING,
        f"{size(net)} of the {size(asked)} asked for; holds {datagrams} datagrams",
        meaning,
        Step(f"Raise the limit{' on the host' if container else ''} until the next boot:", f"sudo sysctl -w {setting}"),
        Step("And for good:", f"echo {setting} | sudo tee /etc/sysctl.d/90-hapticnet-{direction}.conf"),
    )


def judge_drops(machine: Machine) -> Finding:
    """Judge the datagrams that the kernel dropped since boot because a program read them too late."""
    counters = _udp_counters(machine)
    received, dropped = counters.get("InDatagrams"), counters.get("RcvbufErrors")
    figures: Figures = {"received": received, "dropped": dropped}
    topic = Topic(SUBJECT, "drops", "Dropped datagrams", figures)
    if received is None or dropped is None:
        return topic.absent("this system does not tell")
    value = f"{dropped} of {received + dropped} since boot"
    if dropped <= MOST_DROPPED * (received + dropped):
        return topic.ok(value)
    return topic.find(
        Verdict.WARNING,
        value,
        "Some program, not necessarily hapticnet, read its datagrams too late, and its buffer was full.",
        Step("List the sockets; after skmem, the number after d counts drops:", "ss -uamp"),
        scale=f"good: up to {MOST_DROPPED:.1%}",
    )


def _udp_counters(machine: Machine) -> dict[str, int]:
    rows = [line.split()[1:] for line in (machine.text("/proc/net/snmp") or "").splitlines() if line.startswith("Udp:")]
    if len(rows) != 2:
        return {}
    return {name: int(number) for name, number in zip(*rows, strict=False) if number.isdigit()}
