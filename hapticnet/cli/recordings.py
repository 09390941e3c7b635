"""``hapticnet info``, ``recover`` and ``export``: recordings of sessions after the session."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from hapticnet.cli import options

if TYPE_CHECKING:
    from hapticnet.recordings.session.session import Session

SETTINGS_SHOWN: Final = ("codec", "parameters", "law", "rate_hz", "on_error", "device_takes")
"""Settings of a master that `info` shows a person; --json has all of them."""

File = Annotated[Path, typer.Argument(metavar="FILE", help="A recording of master or slave: .mcap, .csv or .npz.")]


def info(
    file: File,
    max_size: options.MaxSize = options.MAX_SIZE,
    json: options.Json = False,
    report: options.Report = None,
) -> None:
    """Print what a recording holds: side, time, rows, events, configuration, and whether it is complete.

    With --json, every setting of the run is part of the configuration.
    """
    from hapticnet.cli.console import check_outputs, deliver
    from hapticnet.recordings.session.reading import read_session

    check_outputs(report, inputs=[file])
    session = read_session(file, max_bytes=max_size)
    account = _account(file, session)
    deliver(account, as_json=json, file=report, shown=_overview(account))


def recover(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="FILE.unfinished, or an .mcap file that is cut off or damaged.")
    ],
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Where the complete recording goes.")] = None,
    json: options.Json = False,
    report: options.Report = None,
) -> None:
    """Complete a recording whose writer was killed, or whose disk was full.

    FILE.unfinished becomes FILE. An .mcap file that is cut off or damaged is kept, and what is whole goes to
    NAME-recovered.mcap.
    """
    from hapticnet.cli.console import Console, check_outputs, deliver
    from hapticnet.recordings.session.recovery import recover_file

    check_outputs(report, inputs=[file])
    done = recover_file(file, out)
    console = Console("recover")
    if done.was_complete:
        console.say(f"{file} is complete; there is nothing to recover")
    elif done.count:
        console.say(f"wrote {done.path}")
    else:
        console.warn(f"nothing in {file} is whole; {done.path} has no rows")
    account = {"file": str(done.path), "recovered": done.count, "was_complete": done.was_complete}
    deliver(account, as_json=json, file=report)


def export(
    file: File,
    csv: Annotated[bool, typer.Option("--csv", help="Write CSV: samples, datagrams, events, configuration.")] = False,
    parquet: Annotated[bool, typer.Option("--parquet", help="Write Parquet.")] = False,
    npz: Annotated[bool, typer.Option("--npz", help="Write a NumPy archive.")] = False,
    mcap: Annotated[bool, typer.Option("--mcap", help="Write MCAP for Foxglove and PlotJuggler.")] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The main file; default: FILE with another suffix.")
    ] = None,
    force: options.Force = False,
    max_size: options.MaxSize = options.MAX_SIZE,
) -> None:
    """Write a recording in another format."""
    from hapticnet.cli.console import Console, check_new, check_outputs
    from hapticnet.errors import SettingsError
    from hapticnet.recordings.session.export import export as write
    from hapticnet.recordings.session.export import exported_files
    from hapticnet.recordings.session.reading import read_session

    flags = {".csv": csv, ".parquet": parquet, ".npz": npz, ".mcap": mcap}
    chosen = [suffix for suffix, is_set in flags.items() if is_set]
    if not chosen and out is not None and out.suffix.lower() in flags:
        chosen = [out.suffix.lower()]
    if len(chosen) != 1:
        raise SettingsError("choose one format: --csv, --parquet, --npz or --mcap")
    target = out or file.with_suffix(chosen[0])
    if target.suffix.lower() != chosen[0]:
        raise SettingsError(f"{target}: expected a name that ends in {chosen[0]}")
    files = exported_files(target)
    check_outputs(*files, inputs=[file])
    check_new(*files, force=force)
    session = read_session(file, max_bytes=max_size)
    write(session, target)
    console = Console("export")
    if not session.complete:
        console.warn(f"{file} is not complete; everything that is whole was exported")
    for each in files:
        if each.exists():
            console.say(f"wrote {each}")


def _account(file: Path, session: "Session") -> dict[str, Any]:
    """Return what is known about a recording, for JSON."""
    from datetime import UTC, datetime, timedelta

    from hapticnet.recordings.notes import time_notes

    t_us = session.main["t_us"].astype("int64")
    account: dict[str, Any] = {
        "file": str(file),
        "bytes": file.stat().st_size,
        "complete": session.complete,
        "side": session.side,
    }
    if len(t_us):
        begun = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=max(0, int(t_us[0]) + session.unix_offset_us))
        duration_s = int(t_us[-1] - t_us[0]) / 1e6
        account |= {
            "begun": begun.isoformat(timespec="milliseconds"),
            "duration_s": duration_s,
            "rate_hz": (len(t_us) - 1) / duration_s if duration_s else None,
        }
    account["rows"] = {name: len(columns["t_us"]) for name, columns in session.tables.items()}
    account["columns"] = {name: ", ".join(columns) for name, columns in session.tables.items()}
    account["notes"] = [{"note": note} for note in time_notes(t_us)] if len(t_us) else []
    account["events"] = [
        {"t_s": (event.t_us - int(t_us[0])) / 1e6 if len(t_us) else None, "event": event.name, "text": event.text}
        for event in session.events
    ]
    account["unix_offset_us"] = session.unix_offset_us
    account["about"] = session.about
    return account


def _overview(account: dict[str, Any]) -> dict[str, Any]:
    """Return the part of an account that a person is shown: a line for each event, and the most important settings."""
    about = {key: value for key, value in account["about"].items() if key != "wire_versions"}
    if isinstance(settings := about.get("settings"), dict):
        about["settings"] = {key: settings[key] for key in SETTINGS_SHOWN if key in settings}
    return {
        **account,
        "complete": "yes" if account["complete"] else f"no; 'hapticnet recover {account['file']}' saves what is whole",
        "notes": [each["note"] for each in account["notes"]],
        "events": [_event_line(**each) for each in account["events"]],
        "about": about,
    }


def _event_line(t_s: float | None, event: str, text: str) -> str:
    time = "" if t_s is None else f"{t_s:10.3f} s  "
    return f"{time}{event}" if text == "{}" else f"{time}{event}  {text}"
