"""Print include/hapticnet_constants.h: the numbers that the C library shares with hapticnet.

    make -C peers/c constants PYTHON=$PWD/.venv/bin/python

Numbers of sessions come from the Python source, the codecs' parameters from the tables of docs/refer/payloads.md, which
a test of hapticnet compares with the source.
"""

import re
from collections.abc import Iterator
from pathlib import Path

from hapticnet import perception, stiffness_bound
from hapticnet.codec import positions, values
from hapticnet.control import hold
from hapticnet.node import decoders, hand_predictor
from hapticnet.node.settings import MasterSettings, SlaveSettings
from hapticnet.protocol import (
    handshake,
    master_session,
    master_stream,
    messages,
    repair,
    seal,
    settings,
    slave_session,
    stats,
    wire,
)
from hapticnet.protocol.settings import RepairSettings, SessionSettings
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES, MOST_COMPONENTS
from hapticnet.scene import ahead
from hapticnet.scene.settings import LARGEST_EXPONENT, LARGEST_SPEED_M_PER_S

ROOT = Path(__file__).parents[2]
PAGES = ("docs/refer/payloads.md", "examples/literature/PAYLOADS.md")
ROW = re.compile(r"^\| `(\w+)` \| (\w+) \| (?:(0) or )?(\S+) … (\S+) \| (\S+) \|$", re.MULTILINE)
SUPERSCRIPTS = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")

SESSION, REPAIR, HOLD, MASTER = SessionSettings(), RepairSettings(), hold.HoldSettings(), MasterSettings()

NUMBERS: dict[str, dict[str, float]] = {
    "Sizes of datagrams and fields [B]": {
        "DATAGRAM_BYTES": wire.MAX_DATAGRAM_BYTES,
        "HELLO_BYTES": messages.HELLO_BYTES,
        "NAME_BYTES": messages.NAME_BYTES,
        "REASON_BYTES": messages.REASON_BYTES,
        "COOKIE_BYTES": messages.COOKIE_BYTES,
        "TICKET_BYTES": messages.TICKET_BYTES,
    },
    "Limits of messages": {
        "MOST_ELEMENTS": wire.MAX_ELEMENTS,
        "MOST_AXES": MAX_AXES,
        "MOST_COMPONENTS": MOST_COMPONENTS,
        "LEAST_RATE_HZ": messages.RATE_HZ.smallest,
        "MOST_RATE_HZ": messages.RATE_HZ.largest,
        "LEAST_SHARE": messages.POSITION_SHARE.smallest,
        "MOST_SHARE": messages.POSITION_SHARE.largest,
        "LEAST_KEEPALIVE_US": messages.KEEPALIVE_US.smallest,
        "MOST_KEEPALIVE_US": messages.KEEPALIVE_US.largest,
        "MOST_CLOCK_US": messages.CLOCK_US.largest,
        "LEAST_VIBRATION_BUDGET": messages.VIBRATION_BUDGET.smallest,
        "MOST_VIBRATION_BUDGET": messages.VIBRATION_BUDGET.largest,
        "LEAST_VIBRATION": messages.VIBRATION_THRESHOLD.smallest,
        "MOST_VIBRATION": messages.VIBRATION_THRESHOLD.largest,
        "MOST_PERCENT": messages.PERCENT.largest,
        "MOST_WAITED_MS": messages.WAITED_MS.largest,
        "LEAST_LAW": perception.SMALLEST,
        "MOST_WEBER_FRACTION": perception.LARGEST_FRACTION,
        "MOST_FLOOR_N": perception.LARGEST_FLOOR_N,
        "MOST_MULTIPLIER": perception.LARGEST_MULTIPLIER,
        "LARGEST_COMPONENT": LARGEST_COMPONENT,
        "LARGEST_COUNT": values.LARGEST_COUNT,
    },
    "What a master asks for unless it is told otherwise": {
        "DEFAULT_WEBER_FRACTION": MASTER.law.weber_fraction,
        "DEFAULT_FLOOR_N": MASTER.law.floor_n,
        "DEFAULT_MULTIPLIER": MASTER.law.multiplier,
        "DEFAULT_RATE_HZ": MASTER.rate_hz,
    },
    "Times of a session [us]": {
        "HELLO_INTERVAL_US": SESSION.hello_interval_us,
        "SLOWEST_HELLO_US": SESSION.slowest_hello_us,
        "REFUSED_RETRY_US": SESSION.refused_retry_us,
        "SLOWEST_RETRY_US": SESSION.slowest_retry_us,
        "NEW_ATTEMPT_US": handshake.FRESH_AFTER_US,
        "STALE_AFTER_US": SESSION.stale_after_us,
        "STALE_INTERVAL_US": SESSION.stale_interval_us,
        "ASK_AGAIN_US": SESSION.ask_again_us,
        "MAX_AGE_US": SESSION.max_age_us,
        "KEEPALIVE_US": SESSION.keepalive_us,
        "DOUBT_MARGIN_US": master_session.DOUBT_MARGIN_US,
        "CLOSE_INTERVAL_US": SESSION.close_interval_us,
        "HALF_OPEN_US": SESSION.half_open_us,
        "GIVES_WAY_US": SESSION.gives_way_us,
        "KEEP_US": SESSION.keep_us,
    },
    "Counts and factors of a session": {
        "QUICK_HELLOS": SESSION.quick_hellos,
        "CLOSE_TRIES": SESSION.close_tries,
        "HELLO_GROWTH": handshake.GROWTH,
        "STALE_GROWTH": master_stream.STALE_GROWTH,
        "RECENT": master_stream.RECENT,
        "TAG_BYTES": seal.TAG_BYTES,
        "EPOCH_BITS": seal.EPOCH_BITS,
        "LAST_SEQUENCE": seal.LAST_SEQUENCE,
        "FASTEST_RATE_HZ": SlaveSettings().fastest_rate_hz,
        "POLICED_SHARE": slave_session.POLICED_SHARE,
        "POLICED_BURST_S": slave_session.POLICED_BURST_S,
    },
    "Arrivals, and the estimate of loss": {
        "WINDOW": stats.WINDOW,
        "LEAP": stats.LEAP,
        "MISORDER": stats.MISORDER,
        "BEHIND_IN_A_ROW": stats.BEHIND_IN_A_ROW,
        "REPORT_EVERY": stats.REPORT_EVERY,
        "REPORT_STEPS": stats.REPORT_STEPS,
        "REORDERED": stats.REORDERED,
        "LOSS_MEMORY": stats.MEMORY,
        "REMEMBERED_LOSSES": stats.REMEMBERED_LOSSES,
        "ASSUMED_ARRIVED": stats.ASSUMED_ARRIVED,
        "ASSUMED_LOST": stats.ASSUMED_LOST,
    },
    "Hold [us, N/s]": {
        "AGE_LIMIT_US": HOLD.age_limit_us,
        "DECAY_US": HOLD.decay_us,
        "RISE_N_PER_S": HOLD.rise_n_per_s,
        "LONGEST_STEP_US": hold.LONGEST_STEP_US,
    },
    "Repair [us]": {
        "INITIAL_TIMEOUT_US": repair.INITIAL_TIMEOUT_US,
        "SHORTEST_TIMEOUT_US": repair.SHORTEST_TIMEOUT_US,
        "LONGEST_TIMEOUT_US": repair.LONGEST_TIMEOUT_US,
        "GRANULARITY_US": repair.GRANULARITY_US,
        "REPORT_LASTS_US": repair.REPORT_LASTS_US,
        "PACE_STEP_US": repair.PACE_STEP_US,
        "SCHEDULING_US": repair.SCHEDULING_US,
        "SHORTEST_WAIT_US": REPAIR.shortest_wait_us,
        "LONGEST_WAIT_US": REPAIR.longest_wait_us,
        "SHORTEST_KEEPALIVE_US": REPAIR.shortest_keepalive_us,
    },
    "Few positions": {
        "LONGEST_SILENCE_US": stiffness_bound.LONGEST_SILENCE_US,
        "ACK_DELAY_US": SESSION.ack_delay_us,
        "IDLE_STALE_US": SESSION.stale_after(True),
        "SPARSE_KEEPALIVES": settings.SPARSE_KEEPALIVES,
        "IDLE_KEEPALIVES": settings.IDLE_KEEPALIVES,
        "IDLE_SHARE": settings.MASTERS_SHARE,
        "IDLE_THRESHOLD_N": settings.LARGEST_N,
        "FASTEST_M_PER_S": positions.FASTEST_M_PER_S,
        "FASTEST_M_PER_S2": positions.FASTEST_M_PER_S2,
        "FADING_S": positions.FADING_S,
        "STIFFEST": positions.STIFFEST,
        "FARTHEST_M": positions.FARTHEST_M,
        "LINE_WINDOW_US": positions.WINDOW_US,
        "LINE_SAMPLES": positions.MOST_SAMPLES,
        "SIGNIFICANT": positions.SIGNIFICANT,
        "UNKNOWN_STIFFNESS": positions.UNKNOWN_STIFFNESS,
    },
    "Recent past: the limit on a force that follows the hand": {
        "PAST_GROWTH": decoders.GROWTH,
        "PAST_MARGIN_N": decoders.MARGIN_N,
        "LATELY_US": decoders.LATELY_US,
        "WAY": decoders.WAY,
        "LONGEST_AHEAD_US": hand_predictor.LONGEST_AHEAD_US,
    },
    "Announced contact": {
        "MOST_LAYERS": ahead.MOST_LAYERS,
        "STIFFEST_PER_HZ": ahead.STIFFEST_PER_HZ,
        "STIFFEST_N_PER_M": ahead.STIFFEST_N_PER_M,
        "LARGEST_FORCE_N": ahead.LARGEST_FORCE_N,
        "LARGEST_VALUE": ahead.LARGEST_VALUE,
        "LARGEST_VISCOSITY": ahead.LARGEST_VISCOSITY,
        "SMALLEST_VALUE": ahead.SMALLEST_VALUE,
        "MODEL_ROUNDING": ahead.ROUNDING,
        "LARGEST_EXPONENT": LARGEST_EXPONENT,
        "LARGEST_SPEED_M_PER_S": LARGEST_SPEED_M_PER_S,
        "MOST_REMEMBERED": decoders.MOST_REMEMBERED,
        "MOST_PLAYED": decoders.MOST_PLAYED,
        "COST_OF_BEGINNING": decoders.COST_OF_BEGINNING,
    },
    "Repair: shares and counts": {
        "DOUBT_LIMIT": REPAIR.doubt_limit,
        "REPEATS_PER_POSITION": REPAIR.repeats_per_position,
        "MOST_CREDIT": repair.MOST_CREDIT,
        "SILENCES_PER_S": REPAIR.silences_per_s,
        "COMPLETE_ABOVE": REPAIR.complete_above,
        "MOST_DATAGRAMS": stats.MOST_DATAGRAMS,
    },
}

RANGES: dict[str, messages.Range] = {
    "rate_hz": messages.RATE_HZ,
    "position_share": messages.POSITION_SHARE,
    "weber_fraction": messages.Range("", perception.SMALLEST, perception.LARGEST_FRACTION, zero_allowed=True),
    "floor_n": messages.Range("", perception.SMALLEST, perception.LARGEST_FLOOR_N, zero_allowed=True),
    "multiplier": messages.Range("", perception.SMALLEST, perception.LARGEST_MULTIPLIER, zero_allowed=True),
    "vibration_budget": messages.VIBRATION_BUDGET,
    "vibration_threshold": messages.VIBRATION_THRESHOLD,
}


def text_of(number: float) -> str:
    """Return a number as a C constant: an int if it is one in Python, else a double."""
    if isinstance(number, int):
        return f"{number}" if number < 1 << 31 else f"INT64_C({number})"
    return repr(number)


def parsed(number: str) -> float:
    """Return a number of the document: 0.5, 10000 or 10⁻¹²."""
    power = re.fullmatch(r"10([⁻⁰-⁹¹²³]+)", number)
    return float(f"1e{power[1].translate(SUPERSCRIPTS)}") if power else float(number)


def in_words(smallest: float, largest: float, zero_allowed: bool, whole: bool = False) -> str:
    """Return what a number must be, as hapticnet's own errors say it."""
    return f"{'0 or ' if zero_allowed else ''}{'a whole number ' if whole else ''}between {smallest:g} and {largest:g}"


def wrongs(names: list[str]) -> Iterator[tuple[str, str]]:
    """Yield what each field of a request must be."""
    yield "codec", f"one of {', '.join(names)}"
    yield "name", f"at most {messages.NAME_BYTES} bytes of printable UTF-8"
    yield "scene", f"at most {messages.NAME_BYTES} bytes of printable UTF-8"
    yield "axes", f"1 to {MAX_AXES}"
    for name, allowed in RANGES.items():
        yield name, in_words(allowed.smallest, allowed.largest, allowed.zero_allowed)


def codecs() -> Iterator[tuple[str, list[tuple[str, ...]]]]:
    """Yield each codec of the documents with the rows of its parameters."""
    for page in PAGES:
        for section in re.split(r"^## ", (ROOT / page).read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]:
            if re.search(r"^Forms: ", section, flags=re.MULTILINE):
                yield section.partition("\n")[0], ROW.findall(section)


def lines() -> Iterator[str]:
    """Yield the lines of the header."""
    yield "/* Made by make_constants.py from the Python source and docs/refer/payloads.md. Do not edit. */"
    yield "#ifndef HAPTICNET_CONSTANTS_H\n#define HAPTICNET_CONSTANTS_H\n"
    for title, numbers in NUMBERS.items():
        yield f"/* {title} */"
        for name, number in numbers.items():
            yield f"#define HN_{name} {text_of(number)}"
        yield ""
    for title, prefix, members in (("Kinds of datagrams", "", wire.Kind), ("Codes", "CODE_", messages.Code)):
        yield f"/* {title} */"
        yield "enum {"
        for member in members:
            yield f"    HN_{prefix}{member.name} = {member.value},"
        yield "};\n"
    found = [(name, name.replace("-", "_").upper(), rows) for name, rows in codecs()]
    most = max(len(rows) for _, _, rows in found)
    yield f"#define HN_MOST_PARAMETERS {most}\n"
    yield "/* What is wrong with a request, or with a slave's scene */"
    for name, right in wrongs([name for name, _, _ in found]):
        yield f'#define HN_WRONG_{name.upper()} "{name} must be {right}"'
    yield ""
    yield "/* Codecs: CODEC(symbol, name, the names of its parameters) */"
    yield "#define HN_CODECS(CODEC) \\"
    yield " \\\n".join(
        f'    CODEC(HN_CODEC_{symbol}, "{name}", "{", ".join(row[0] for row in rows)}")' for name, symbol, rows in found
    )
    yield ""
    yield "/* Their parameters: PARAMETER(codec, name, least, most, or zero, whole, default, what it must be) */"
    yield "#define HN_PARAMETERS(PARAMETER) \\"
    yield (
        " \\\n".join(
            f'    PARAMETER(HN_CODEC_{symbol}, "{key}",'
            f" {parsed(low)!r}, {parsed(high)!r}, {int(bool(zero))}, {int(kind == 'int')}, {parsed(default)!r},"
            f' "{in_words(parsed(low), parsed(high), bool(zero), kind == "int")}")'
            for _, symbol, rows in found
            for key, kind, zero, low, high, default in rows
        )
        + "\n"
    )
    yield "/* Places of the parameters among those of their codec */"
    for _, symbol, rows in found:
        names = ", ".join(f"HN_{symbol}_{row[0].upper()}" for row in rows)
        yield f"enum {{ {names} }};"
    yield "\n#endif"


if __name__ == "__main__":
    print("\n".join(lines()))
