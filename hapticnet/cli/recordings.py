"""``hapticnet info`` and ``export``: recordings of sessions after the session."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, get_args

import typer

from hapticnet import options

if TYPE_CHECKING:
    from hapticnet.recordings.session.session import Session

LEFT_OUT: Final = ("wire_versions", "asked_at_start", "request", "grant")
"""Entries that `info` shows only with --json: requested settings may differ from those in force."""

File = Annotated[Path, typer.Argument(metavar="FILE", help="A recording of master or slave: .mcap, .csv or .npz.")]


def info(
    file: File,
    max_size: options.MaxSize = options.MAX_SIZE,
    json: options.Json = False,
    report: options.Report = None,
) -> None:
    """Print what a recording contains: side, time, rows, events, settings in force, and whether it is complete."""
    from hapticnet.cli.console import check_outputs, deliver
    from hapticnet.recordings.session.reading import read_session

    check_outputs(report, inputs=[file])
    session = read_session(file, max_bytes=max_size)
    account = _account(file, session)
    deliver(account, as_json=json, file=report, shown=_overview(account))


def export(
    file: File,
    form: Annotated[
        options.ExportFormat | None,
        typer.Option(
            "--format",
            help="Format to write; default: that of --out, or of the recording that FILE.unfinished was to be.",
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="The main file; default: FILE with another suffix.")
    ] = None,
    overwrite: options.Overwrite = False,
    max_size: options.MaxSize = options.MAX_SIZE,
) -> None:
    """Write a recording in another format, or again as far as it is whole: FILE.unfinished, or one that is damaged.

    The format mcap is for Foxglove and PlotJuggler. FILE is kept.
    """
    from hapticnet.cli.console import Console, check_new, check_outputs
    from hapticnet.errors import SettingsError
    from hapticnet.recordings.session.export import export as write
    from hapticnet.recordings.session.export import exported_files
    from hapticnet.recordings.session.reading import read_session
    from hapticnet.recordings.session.sink import named, refuse_if_recorded

    whole = named(file)
    like = whole if out is None and whole != file else out
    chosen = form or ("" if like is None else like.suffix.lower().removeprefix("."))
    if chosen not in get_args(options.ExportFormat):
        raise SettingsError("choose a format: --format csv, mcap or npz")
    target = out or whole.with_suffix(f".{chosen}")
    if target.suffix.lower() != f".{chosen}":
        raise SettingsError(f"{target}: expected a name that ends in .{chosen}")
    if whole != file:
        refuse_if_recorded(whole)
    session = read_session(file, max_bytes=max_size)  # first: else its name might be blamed
    files = exported_files(target)
    check_outputs(*files, inputs=[file])
    check_new(*files, overwrite=overwrite)
    write(session, target)
    console = Console("export")
    if not session.complete:
        console.warn(f"{file} is not complete; its undamaged part was exported")
    for each in files:
        if each.exists():
            console.say(f"wrote {each}")


def _account(file: Path, session: "Session") -> dict[str, Any]:
    """Return the contents and facts of a recording, for JSON."""
    from datetime import UTC, datetime, timedelta

    from hapticnet.recordings.loading import time_notes
    from hapticnet.recordings.session.session import change_notes, in_force

    t_us = session.main["t_us"].astype("int64")
    account: dict[str, Any] = {
        "file": str(file),
        "bytes": file.stat().st_size,
        "is_whole": session.is_whole,
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
    notes = [*(time_notes(t_us) if len(t_us) else ()), *change_notes(session.events)]
    account["notes"] = [{"note": note} for note in notes]

    def t_s(event_us: int) -> float | None:
        return (event_us - int(t_us[0])) / 1e6 if len(t_us) else None

    account["in_force"] = [{"t_s": t_s(since_us), **settings} for since_us, settings in in_force(session.events)]
    account["events"] = [{"t_s": t_s(event.t_us), "event": event.name, "text": event.text} for event in session.events]
    account["unix_offset_us"] = session.unix_offset_us
    account["about"] = session.about
    return account


def _overview(account: dict[str, Any]) -> dict[str, Any]:
    """Return the part of an account for a person: a line for each event, and the most important settings."""
    from hapticnet.recordings.session.session import IN_FORCE, INCOMPLETE, settings_line

    about = {key: value for key, value in account["about"].items() if key not in (*LEFT_OUT, INCOMPLETE)}
    return {
        **{key: value for key, value in account.items() if key != "is_whole"},
        "complete": _complete_in_words(account),
        "notes": [each["note"] for each in account["notes"]],
        "in_force": [_line(each.pop("t_s"), settings_line(each)) for each in map(dict, account["in_force"])],
        "events": [
            _line(each["t_s"], each["event"] if each["text"] == "{}" else f"{each['event']}  {each['text']}")
            for each in account["events"]
            if each["event"] != IN_FORCE
        ],
        "about": about,
    }


def _line(t_s: float | None, text: str) -> str:
    return text if t_s is None else f"{t_s:10.3f} s  {text}"


def _complete_in_words(account: dict[str, Any]) -> str:
    from hapticnet.recordings.session.session import INCOMPLETE

    if account["complete"]:
        return "yes"
    if not account["is_whole"]:
        return f"no, cut off or damaged; 'hapticnet export {account['file']} --out OTHER' saves what is whole"
    return f"no; {account['about'].get(INCOMPLETE, 'its recording stopped before its session ended')}"
