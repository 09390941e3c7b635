"""Features that verbs share: ``--config``, groups of options, and examples."""

import dataclasses
import functools
import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final, cast

import typer
from typer.core import TyperCommand
from typer.models import ParameterInfo

from hapticnet.cli.examples import EXAMPLES
from hapticnet.cli.settings import Verb, from_file, option_key, wanted
from hapticnet.cli.values import check_values
from hapticnet.files import user_path
from hapticnet.options import option_of
from hapticnet.runtime.nonblocking_log import keep_log

SERVICES: Final = ("master", "slave")
"""Verbs that run until they are stopped: they read a configuration, and their lines on stderr have time and level."""

SOURCE: Final = "hapticnet.source"  # where a context keeps which file and table gave its defaults

UNITS: Final = {"duration": "SECONDS", "sampling_rate": "HZ", "floor": "NEWTONS", "rate": "HZ", "weber": "FRACTION"}
VALUES: Final = {bool: None, int: "N", float: "NUMBER", Path: "FILE", str: "TEXT"}
"""Metavars for parameters that define none: by parameter, else by type."""


def equip(app: typer.Typer, verb: Verb = (), examples: Mapping[Verb, Sequence[str]] = EXAMPLES) -> None:
    """Add to each verb of an application the features that verbs share.

    `verb` is that of the application itself; `examples` has the lines at the end of the help of each.
    """
    for name, group in _groups(app, verb):
        group.info.epilog = _examples(examples.get(name))
        for info in group.registered_commands:
            function: Any = info.callback
            words = (*name, info.name or function.__name__.replace("_", "-"))
            info.callback = _equipped(function, serves=words[0] in SERVICES)
            info.cls = GroupedCommand
            info.epilog = _examples(examples.get(words))


def _groups(app: typer.Typer, verb: Verb) -> Iterator[tuple[Verb, typer.Typer]]:
    yield verb, app
    for group in app.registered_groups:
        if group.typer_instance is not None and group.name is not None:
            yield from _groups(group.typer_instance, (*verb, group.name))


def _examples(lines: Sequence[str] | None) -> str | None:
    """Return the text below the options in the help of a verb."""
    return None if lines is None else "\b\nExamples:\n" + "\n".join(f"  {line}" for line in lines)


def _equipped(function: Callable[..., None], *, serves: bool) -> Callable[..., None]:
    """Return a verb as typer reads it: a parameter for each option, declared by a dataclass or one by one.

    Its options are checked before it begins.
    """
    own = list(inspect.signature(function).parameters.values())
    make: Any = own[0].annotation if len(own) == 1 and dataclasses.is_dataclass(own[0].annotation) else None
    if make is not None:
        defaults = ((each, each.default) for each in dataclasses.fields(make))
        own = [
            _parameter(each.name, each.type, inspect.Parameter.empty if value is dataclasses.MISSING else value)
            for each, value in defaults
        ]
    own = [_parameter(each.name, _typed(each.name, each.annotation), each.default) for each in own]

    @functools.wraps(function)
    def verb(ctx: typer.Context, **options: Any) -> None:
        options = {each.name: _with_home(options[each.name]) for each in own}
        check_values(ctx, options)
        for each in own:
            if (option := option_of(each.annotation)) is not None:
                option.check(f"--{each.name.replace('_', '-')}", options[each.name])
        if make is not None:
            function(make(**options))
        else:
            function(**options)

    common = [_parameter("ctx", typer.Context)]
    if serves:
        common.append(_parameter("config", Annotated[Path | None, CONFIG], None))
    made: Any = verb
    made.__signature__ = inspect.Signature([*own, *common])
    made.__annotations__ = {each.name: each.annotation for each in (*own, *common)}
    return verb


def _parameter(name: str, annotation: Any, default: Any = inspect.Parameter.empty) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _typed(name: str, annotation: Any) -> Any:
    """Return the annotation of a parameter in typer's words, with what its value is called."""
    if (option := option_of(annotation)) is not None:
        told: dict[str, Any] = {"metavar": option.metavar, "help": option.help, "parser": option.parser}
        told |= {"show_default": option.show_default, "envvar": option.variable}
        if option.most is None:
            told["min"] = option.least
        told = {key: value for key, value in told.items() if value is not None}
        info = typer.Argument(**told) if option.argument else typer.Option(*option.flags, **told)
        annotation = Annotated[annotation.__origin__, info, option]
    for info in getattr(annotation, "__metadata__", ()):
        if isinstance(info, ParameterInfo):
            kinds = {annotation.__origin__, *getattr(annotation.__origin__, "__args__", ())}
            by_type = next((value for each, value in VALUES.items() if each in kinds), None)
            info.metavar = info.metavar or UNITS.get(name) or by_type
    return annotation


def _configure(ctx: typer.Context, path: Path | None) -> Path | None:
    """Choose the form of log lines, and let the other options find values in a file; called before they are read."""
    if not ctx.resilient_parsing:
        keep_log()
        if path is not None:
            path = user_path(path)
            commands: dict[str, Any] = {name: cast("Any", ctx.find_root().command).commands[name] for name in SERVICES}
            ctx.default_map = from_file(path, commands)[str(ctx.info_name)]
            ctx.meta[SOURCE] = f"{path} [{ctx.info_name}]"
    return path


CONFIG: Final = typer.Option(
    "--config",
    envvar="HAPTICNET_CONFIG",
    metavar="FILE",
    is_eager=True,
    callback=_configure,
    help="Take options that are not given here from this TOML file.",
)


def _with_home(value: Any) -> Any:
    """Return the value of an option, with ``~`` expanded in paths: shells do not do so in ``--key=~/key.toml``."""
    if isinstance(value, list):
        return [_with_home(each) for each in value]
    return user_path(value) if isinstance(value, Path) else value


GROUPS: Final[dict[str, tuple[str, ...]]] = {
    "Connection": (
        "connect", "listen", "connect-timeout", "name", "scheduler", "most-sessions",
        "most-sessions-per-key", "keep", "drain", "fastest-rate",
    ),
    "Keys": ("key", "peer-key", "masters", "insecure"),
    "Operator and device": (
        "operator", "insertions", "scale", "force-scale", "frame", "offset", "hand", "rate", "positions",
        "position-share", "device", "device-takes", "profile", "from", "to", "stiffness",
    ),
    "Safety": ("coupling", "max-age", "max-force", "first-touch"),
    "Scene and contact": ("scene", "walls", "announce", "announced", "predicted", "vibration", "vibration-budget"),
    "Codec and perception": (
        "codec", "codecs", "add-codec", "multiplier", "multipliers", "weber", "floor", "law",
    ),
    "Emulated network": ("channel-out", "channel-in", "delay", "delays", "loss", "jitter"),
    "Reading of files": (
        "force-column", "position-column", "time-column", "position-scale", "start", "sampling-rate",
        "missing", "max-size",
    ),
    "Study": ("repeats", "shard"),
    "Recording": ("record", "record-dir", "record-format", "record-limit"),
    "Page and monitoring": ("page", "speed", "loop", "metrics"),
    "Tables and plots": (
        "by", "of", "where", "csv", "plot", "plot-dir", "plot-format", "x", "y", "line", "panel",
    ),
    "Output": (
        "out", "out-dir", "format", "overwrite", "json", "report", "quiet",
    ),
    "Running": ("duration", "seed", "jobs", "real-time", "quick", "config", "help"),
}  # fmt: skip
"""Names of options by group, the same group in the help of every verb; others are of a package's verb alone."""


class GroupedCommand(TyperCommand):
    """A verb whose help shows its options in `GROUPS`, and that refuses empty values."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Refuse empty values, which no option accepts: a script's variable may be unset."""
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
        grouped = {name for names in GROUPS.values() for name in names}
        sections["Options"] = [_record(each, ctx) for name, each in options.items() if name not in grouped]
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
