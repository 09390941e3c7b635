"""What was in force during a recording, told by its events ``SettingsInForce`` (`node.events`)."""

import sys
from collections.abc import Iterable, Mapping
from typing import Any, Final

from hapticnet.recordings.session.session import Event, parse_json

EVENT: Final = "SettingsInForce"


def in_force(events: Iterable[Event]) -> list[tuple[int, dict[str, Any]]]:
    """Return the times [µs] from which settings were in force, and the settings.

    Each holds until the next, the last until the end. Before the first there was no session. Events whose text is
    damaged are left out.
    """
    found: list[tuple[int, dict[str, Any]]] = []
    for event in events:
        if event.name == EVENT:
            try:
                settings = parse_json(event.text)
            except ValueError:
                continue
            if isinstance(settings, dict):
                found.append((event.t_us, settings))
    return found


def settings_line(settings: Mapping[str, Any]) -> str:
    """Return settings in force as a line for a person."""

    def number(name: str) -> str:
        value = settings.get(name)
        return f"{value:g}" if isinstance(value, (int, float)) and abs(value) < sys.float_info.max else "?"

    parameters = settings.get("parameters")
    texts = [f"{name}={value}" for name, value in parameters.items()] if isinstance(parameters, dict) else []
    codec = f"{settings.get('codec')}{':' * bool(texts)}{','.join(texts)}"
    law = f"{number('multiplier')} JND (weber {number('weber_fraction')}, floor {number('floor_n')} N)"
    line = f"{codec} at {law}, {number('rate_hz')} Hz, scene {settings.get('scene')}"
    if settings.get("position_share"):
        line += f", positions on a line with {number('position_share')} of the JND"
    if settings.get("announced"):
        line += ", announced"
    for way in ("channel_out", "channel_in"):
        if settings.get(way):
            line += f", {way.replace('_', ' ')} {settings[way]}"
    return line


def change_notes(events: Iterable[Event]) -> tuple[str, ...]:
    """Return a note that what was in force changed, for a person who computes with one codec, JND or delay."""
    spans = in_force(events)
    if len(spans) < 2:
        return ()
    changed = {name for _, settings in spans for name in settings if settings.get(name) != spans[0][1].get(name)}
    times = ", ".join(str(t_us) for t_us, _ in spans[1:6])
    more = f" and {len(spans) - 6} times more" if len(spans) > 6 else ""
    note = (
        f"{', '.join(sorted(changed))} changed during this recording, at t_us {times}{more}: none of them holds for all"
        " of it; 'hapticnet info' lists what was in force when"
    )
    return (note,)
