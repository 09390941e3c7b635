"""The groups of options in the help, and their one order for all verbs."""

import re
from typing import Any, Final, cast

import typer
from typer.core import TyperCommand

from hapticnet.cli.settings import option_key, wanted

GROUPS: Final[dict[str, tuple[str, ...]]] = {
    "Connection": (
        "connect", "listen", "connect-timeout", "name", "scheduler", "most-sessions", "most-sessions-per-key", "keep",
        "drain", "fastest-rate",
    ),
    "Keys": ("key", "peer-key", "masters", "insecure"),
    "Operator and device": (
        "operator", "insertions", "rate", "positions", "position-share", "device", "device-takes", "profile", "from",
        "to", "stiffness", "link", "pairs",
    ),
    "Safety": ("passive", "max-age", "max-force", "first-touch"),
    "Scene and contact": ("scene", "announce", "announced"),
    "Codec and perception": (
        "codec", "codecs", "add-codec", "multiplier", "multipliers", "weber", "floor", "law", "grid",
    ),
    "Emulated network": ("channel-out", "channel-in", "delay", "loss"),
    "Reading of files": (
        "trace", "force-column", "position-column", "time-column", "position-scale", "start", "sampling-rate",
        "missing", "max-size",
    ),
    "Study": (
        "participant", "session", "plan", "simulate", "wall-clock", "resume", "analyse", "shares", "participants",
        "trials", "experiments", "margin", "motions", "repeats", "shard", "dry-run",
    ),
    "Recording": ("record", "record-dir", "record-format", "record-limit"),
    "Page and monitoring": ("page", "metrics"),
    "Tables and plots": (
        "by", "of", "quantiles", "where", "csv", "latex", "plot", "plot-dir", "plot-format", "plots", "x", "y", "line",
        "panel", "signal", "window",
    ),
    "Output": (
        "out", "out-dir", "format", "bids", "title", "authors", "overwrite", "json", "report", "quiet",
        "log-json",
    ),
    "Running": ("duration", "seed", "jobs", "real-time", "quick", "config", "help"),
}  # fmt: skip
"""Names of options, each in the one group that it has in the help of every verb."""


class GroupedCommand(TyperCommand):
    """A verb whose help shows its options in `GROUPS`, and that refuses empty values."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Refuse empty values, which mean nothing to any option: a variable of a script may be unset."""
        given = {} if ctx.resilient_parsing else self.make_parser(ctx).parse_args(list(args))[0]
        for each in cast("list[Any]", self.params):
            value = given.get(each.name)
            values = value if each.param_type_name == "option" and isinstance(value, list) else [value]
            if any(isinstance(text, str) and not text.strip() for text in values):
                raise typer.BadParameter(f"it is empty; {wanted(each)}", ctx=ctx, param=each)
        return super().parse_args(ctx, args)

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write arguments, then each group that has an option of this verb."""
        parameters = self.get_params(ctx)
        options = {option_key(each): each for each in parameters if each.param_type_name == "option"}
        sections = {"Arguments": [each.get_help_record(ctx) for each in parameters if each not in options.values()]}
        for group, names in GROUPS.items():
            sections[group] = [_record(options[name], ctx) for name in names if name in options]
        for title, records in sections.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)


def _record(option: Any, ctx: Any) -> tuple[str, str]:
    """Return an option and its help: a flag as ``--[no-]name``, with its default only if it is on."""
    names, text = option.get_help_record(ctx)
    if option.is_flag:
        names = re.sub(r"--(\S+) / --no-\1", r"--[no-]\1", names)
        text = re.sub(r"  \[default: no-\S+\]$", "", text)
    return names, text
