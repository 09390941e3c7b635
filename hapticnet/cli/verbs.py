"""Features that all verbs share: ``--config``, environment variables, groups and examples."""

import dataclasses
import functools
import inspect
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final, cast

import typer
from typer.core import TyperCommand
from typer.models import ParameterInfo

from hapticnet.cli.examples import EXAMPLES
from hapticnet.cli.settings import (
    CONFIG_VARIABLE,
    FLAGS,
    FOUND,
    Verb,
    load_found,
    option_key,
    unknown_variables,
    variable,
    verb_of,
    wanted,
)
from hapticnet.cli.values import check_values
from hapticnet.errors import HapticnetError
from hapticnet.files import user_path
from hapticnet.options import option_of
from hapticnet.runtime.nonblocking_log import STDERR, Form, Level, LogLine, keep_log

LOGGING: Final = {("master",), ("slave",)}
"""Verbs that run until they are stopped: their lines on stderr have time and level."""

UNITS: Final = {"duration": "SECONDS", "sampling_rate": "HZ", "floor": "NEWTONS", "rate": "HZ", "weber": "FRACTION"}
VALUES: Final = {bool: None, int: "N", float: "NUMBER", Path: "FILE", str: "TEXT"}
"""Metavars for parameters that define none: by parameter, else by type."""


def equip(app: typer.Typer) -> None:
    """Add to each verb of an application the features that all verbs share."""
    for verb, group in _groups(app, ()):
        group.info.epilog = _examples(verb)
        for info in group.registered_commands:
            function: Any = info.callback
            words = (*verb, info.name or function.__name__.replace("_", "-"))
            info.callback = _equipped(function, log=words in LOGGING)
            info.cls = GroupedCommand
            info.epilog = _examples(words)


def _groups(app: typer.Typer, verb: Verb) -> Iterator[tuple[Verb, typer.Typer]]:
    yield verb, app
    for group in app.registered_groups:
        if group.typer_instance is not None and group.name is not None:
            yield from _groups(group.typer_instance, (*verb, group.name))


def _examples(verb: Verb) -> str | None:
    """Return the text below the options in the help of a verb."""
    lines = EXAMPLES.get(verb)
    return None if lines is None else "\b\nExamples:\n" + "\n".join(f"  {line}" for line in lines)


def _equipped(function: Callable[..., None], *, log: bool) -> Callable[..., None]:
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
        _warn_of_variables(ctx)
        check_values(ctx, options)
        for each in own:
            if (option := option_of(each.annotation)) is not None:
                option.check(f"--{each.name.replace('_', '-')}", options[each.name])
        if make is not None:
            function(make(**options))
        else:
            function(**options)

    common = [_parameter("ctx", typer.Context), _parameter("config", Annotated[Path | None, CONFIG], None)]
    if log:
        common.append(_parameter("log_json", Annotated[bool, LOG_JSON], False))
    return _with_signature(verb, [*own, *common])


def _parameter(name: str, annotation: Any, default: Any = inspect.Parameter.empty) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _with_signature(function: Any, parameters: list[inspect.Parameter]) -> Callable[..., None]:
    function.__signature__ = inspect.Signature(parameters)
    function.__annotations__ = {each.name: each.annotation for each in parameters}
    verb: Callable[..., None] = function
    return verb


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
    """Let the other options find their values in file and environment; called before they are read."""
    if not ctx.resilient_parsing:
        path = None if path is None else user_path(path)
        ctx.meta[FOUND] = found = load_found(ctx, path, os.environ)
        ctx.default_map = {name: each.value for name, each in found.items()}
    return path


def asks_for_json(arguments: Sequence[str], environment: Mapping[str, str]) -> bool:
    """Return whether command line, environment or configuration ask for log lines in JSON, before any is checked.

    Errors in the configuration are reported later, when it is fully read.
    """
    verb = tuple(arguments[:1])
    if "--log-json" in arguments:
        return True
    if verb not in LOGGING or "--no-log-json" in arguments:
        return False
    if text := environment.get(variable(verb, "log-json"), ""):
        return FLAGS.get(text.lower(), False)
    named = [after for word, after in pairwise(arguments) if word == "--config"]
    named += [word.partition("=")[2] for word in arguments if word.startswith("--config=")]
    path = named[-1] if named else environment.get(CONFIG_VARIABLE)
    if not path:
        return False
    from hapticnet.documents import parse_tables, read_document

    try:
        table = parse_tables(read_document(user_path(path)), path).get(verb[0])
    except HapticnetError:
        return False
    return isinstance(table, dict) and table.get("log-json") is True


def _choose_log(as_json: bool) -> bool:
    """Choose the form of log lines before anything is printed."""
    if as_json:
        STDERR.form = Form.JSON
    else:
        keep_log()
    return as_json


CONFIG: Final = typer.Option(
    "--config",
    envvar=CONFIG_VARIABLE,
    metavar="FILE",
    is_eager=True,
    callback=_configure,
    help="Take options that are not given here from this TOML file.",
)
LOG_JSON: Final = typer.Option(
    "--log-json/--no-log-json", is_eager=True, callback=_choose_log, help="Write each line on stderr as a JSON object."
)


def _with_home(value: Any) -> Any:
    """Return the value of an option, with ``~`` expanded in paths: shells do not do so in ``--key=~/key.toml``."""
    if isinstance(value, list):
        return [_with_home(each) for each in value]
    return user_path(value) if isinstance(value, Path) else value


def _warn_of_variables(ctx: typer.Context) -> None:
    verb = verb_of(ctx)
    for line in unknown_variables(verb, ctx.command, os.environ):
        STDERR.line(LogLine(line, who=" ".join(verb), level=Level.WARNING))


GROUPS: Final[dict[str, tuple[str, ...]]] = {
    "Connection": (
        "connect", "listen", "connect-timeout", "name", "most-sessions", "most-sessions-per-key", "keep",
        "drain", "fastest-rate",
    ),
    "Keys": ("key", "peer-key", "masters", "insecure"),
    "Operator and device": (
        "operator", "insertions", "rate", "positions", "position-share", "device", "device-takes", "profile", "from",
        "to", "stiffness", "link", "pairs",
    ),
    "Safety": ("passive", "max-age", "max-force", "first-touch"),
    "Scene and contact": ("scene", "announce", "announced", "predicted"),
    "Codec and perception": (
        "codec", "codecs", "add-codec", "multiplier", "multipliers", "weber", "floor", "law",
    ),
    "Emulated network": ("channel-out", "channel-in", "delay", "loss"),
    "Reading of files": (
        "force-column", "position-column", "time-column", "position-scale", "start", "sampling-rate",
        "missing", "max-size",
    ),
    "Study": (
        "participant", "session", "plan", "simulate", "wall-clock", "resume", "analyse", "shares", "participants",
        "trials", "experiments", "margin", "repeats", "shard", "dry-run",
    ),
    "Recording": ("record", "record-dir", "record-format", "record-limit"),
    "Page and monitoring": ("page", "metrics"),
    "Tables and plots": (
        "by", "of", "quantiles", "where", "csv", "plot", "plot-dir", "plot-format", "plots", "x", "y", "line", "panel",
    ),
    "Output": (
        "out", "out-dir", "format", "overwrite", "json", "report", "quiet", "log-json",
    ),
    "Running": ("duration", "seed", "jobs", "real-time", "quick", "config", "help"),
}  # fmt: skip
"""Names of options by group, the same group in the help of every verb."""


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
