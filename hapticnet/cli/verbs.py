"""What every verb has besides its own options: ``--config``, environment variables, examples; a log for some."""

import dataclasses
import functools
import inspect
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from hapticnet.cli.completions import COMPLETIONS
from hapticnet.cli.examples import EXAMPLES
from hapticnet.cli.groups import GroupedCommand
from hapticnet.cli.settings import (
    CONFIG_VARIABLE,
    FLAGS,
    Found,
    Verb,
    load_found,
    unknown_variables,
    variable,
    verb_of,
)
from hapticnet.cli.value_checks import check_values
from hapticnet.errors import HapticnetError
from hapticnet.files import user_path
from hapticnet.options import Option, option_of
from hapticnet.runtime.nonblocking_log import STDERR, Form, Level, keep_log, log_line

LOGGING: Final = {("master",), ("slave",), ("replay",)}
"""Verbs that run until they are stopped: their lines on stderr have time and level."""

UNITS: Final = {  # what the help calls the values of these parameters, wherever they have no name of their own
    "duration": "SECONDS",
    "sampling_rate": "HZ",
    "floor": "NEWTONS",
    "rate": "HZ",
    "weber": "FRACTION",
}

VALUES: Final = {bool: None, int: "N", float: "NUMBER", Path: "FILE", str: "TEXT"}
"""What it calls the values of other parameters, by type."""

FOUND: Final = "hapticnet.found"  # where a context keeps what file and environment set


def equip(app: typer.Typer) -> None:
    """Add to each verb of an application what all verbs have."""
    for verb, info in _verbs(app, ()):
        function = info.callback = _with_declared_options(info.callback)
        _describe_values(function)
        if "ctx" not in inspect.signature(function).parameters:  # config prints the options of other verbs
            info.callback = _with_common_options(function, log=verb in LOGGING)
        info.cls = GroupedCommand
        info.epilog = _examples(verb)
    for verb, group in _groups(app, ()):
        group.info.epilog = _examples(verb)


def found_of(ctx: typer.Context) -> dict[str, Found]:
    """Return what file and environment set, by the parameters' names."""
    found: dict[str, Found] = ctx.meta.get(FOUND, {})
    return found


def _verbs(app: typer.Typer, verb: Verb) -> Iterator[tuple[Verb, Any]]:
    for info in app.registered_commands:
        function: Any = info.callback
        yield (*verb, info.name or function.__name__.replace("_", "-")), info
    for group in app.registered_groups:
        if group.typer_instance is not None and group.name is not None:
            yield from _verbs(group.typer_instance, (*verb, group.name))


def _groups(app: typer.Typer, verb: Verb) -> Iterator[tuple[Verb, typer.Typer]]:
    yield verb, app
    for group in app.registered_groups:
        if group.typer_instance is not None and group.name is not None:
            yield from _groups(group.typer_instance, (*verb, group.name))


def _examples(verb: Verb) -> str | None:
    """Return what stands below the options in the help of a verb."""
    lines = EXAMPLES.get(verb)
    return None if lines is None else "\b\nExamples:\n" + "\n".join(f"  {line}" for line in lines)


def _with_declared_options(function: Callable[..., None]) -> Callable[..., None]:
    """Return a function with a parameter for each field, if its one parameter is a dataclass; typer reads the rest."""
    own = list(inspect.signature(function).parameters.values())
    verb = function
    given: Any = own[0].annotation if len(own) == 1 else None
    if dataclasses.is_dataclass(given):
        own = [
            inspect.Parameter(
                each.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if each.default is dataclasses.MISSING else each.default,
                annotation=each.type,
            )
            for each in dataclasses.fields(given)
        ]
        make: Any = given

        @functools.wraps(function)
        def verb(**options: Any) -> None:
            function(make(**options))

    own = [each.replace(annotation=_typed(each.annotation)) for each in own]
    verb.__signature__ = inspect.Signature(own)  # type: ignore[attr-defined]
    verb.__annotations__ = {each.name: each.annotation for each in own}
    return verb


def _typed(annotation: Any) -> Any:
    """Return an annotation with the option that it declares in typer's words, too."""
    if (option := option_of(annotation)) is None:
        return annotation
    told: dict[str, Any] = {"metavar": option.metavar, "help": option.help, "parser": option.parser}
    told |= {"show_default": option.show_default, "envvar": option.variable}
    if option.most is None:
        told["min"] = option.least
    told = {name: value for name, value in told.items() if value is not None}
    info = typer.Argument(**told) if option.argument else typer.Option(*option.flags, **told)
    return Annotated[annotation.__origin__, info, option]


def _describe_values(function: Callable[..., None]) -> None:
    """Name the value of each parameter in the help, and let the shell complete those that `COMPLETIONS` names."""
    for parameter in inspect.signature(function).parameters.values():
        for info in getattr(parameter.annotation, "__metadata__", ()):
            if isinstance(info, Option):
                continue
            if parameter.name in COMPLETIONS and info.autocompletion is None:
                info.autocompletion = COMPLETIONS[parameter.name]
            if info.metavar is None:
                info.metavar = UNITS.get(parameter.name) or _value_of(parameter.annotation.__origin__)


def _value_of(kind: Any) -> str | None:
    """Return the name of a value of this type; None where the parser's is good: flags and choices."""
    kinds = {kind, *getattr(kind, "__args__", ())}
    return next((name for each, name in VALUES.items() if each in kinds), None)


def _configure(ctx: typer.Context, path: Path | None) -> Path | None:
    """Let the other options find their values in file and environment; called before they are read."""
    if not ctx.resilient_parsing:
        path = None if path is None else user_path(path)
        ctx.meta[FOUND] = found = load_found(ctx, path, os.environ)
        ctx.default_map = {name: each.value for name, each in found.items()}
    return path


def asks_for_json(arguments: Sequence[str], environment: Mapping[str, str]) -> bool:
    """Return whether command line, environment or configuration ask for log lines in JSON, before any is checked."""
    verb = tuple(arguments[:1])
    if "--log-json" in arguments:
        return True
    if verb not in LOGGING or "--no-log-json" in arguments:
        return False
    if text := environment.get(variable(verb, "log-json"), ""):
        return FLAGS.get(text.lower(), False)
    return _file_asks_for_json(verb[0], arguments, environment)


def _file_asks_for_json(verb: str, arguments: Sequence[str], environment: Mapping[str, str]) -> bool:
    """Return whether the configuration asks for it; what is wrong with that file is told when it is read for good."""
    named = [after for word, after in pairwise(arguments) if word == "--config"]
    named += [word.partition("=")[2] for word in arguments if word.startswith("--config=")]
    path = named[-1] if named else environment.get(CONFIG_VARIABLE)
    if not path:
        return False
    from hapticnet.documents import parse_tables, read_document

    try:
        table = parse_tables(read_document(user_path(path)), path).get(verb)
    except HapticnetError:
        return False
    return isinstance(table, dict) and table.get("log-json") is True


def _choose_log(as_json: bool) -> bool:
    """Choose the form of log lines before anything can be said."""
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
    help="Take options that are not given here from this TOML file; hapticnet config shows which.",
)
LOG_JSON: Final = typer.Option(
    "--log-json/--no-log-json", is_eager=True, callback=_choose_log, help="Write each line on stderr as a JSON object."
)


def _with_common_options(function: Callable[..., None], *, log: bool) -> Callable[..., None]:
    """Return a function with the signature of another one and the options that all verbs have."""
    added = [
        inspect.Parameter("ctx", inspect.Parameter.KEYWORD_ONLY, annotation=typer.Context),
        inspect.Parameter(
            "config", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=Annotated[Path | None, CONFIG]
        ),
    ]
    if log:
        added.append(
            inspect.Parameter(
                "log_json", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=Annotated[bool, LOG_JSON]
            )
        )
    own = inspect.signature(function)

    @functools.wraps(function)
    def verb(ctx: typer.Context, **options: Any) -> None:
        for each in added[1:]:
            del options[each.name]
        options = {name: _with_home(value) for name, value in options.items()}
        _warn_of_variables(ctx)
        check_values(ctx, options)
        for each in own.parameters.values():
            if (option := option_of(each.annotation)) is not None:
                option.check(f"--{each.name.replace('_', '-')}", options[each.name])
        function(**options)

    parameters = [each.replace(kind=inspect.Parameter.KEYWORD_ONLY) for each in own.parameters.values()]
    verb.__signature__ = own.replace(parameters=[*parameters, *added])  # type: ignore[attr-defined]
    verb.__annotations__ = function.__annotations__ | {each.name: each.annotation for each in added}
    return verb


def _with_home(value: Any) -> Any:
    """Return the value of an option, a path with its ``~`` replaced: the shell leaves it in ``--key=~/key.toml``."""
    if isinstance(value, list):
        return [_with_home(each) for each in value]
    return user_path(value) if isinstance(value, Path) else value


def _warn_of_variables(ctx: typer.Context) -> None:
    verb = verb_of(ctx)
    for line in unknown_variables(verb, ctx.command, os.environ):
        STDERR.line(log_line(line, who=" ".join(verb), level=Level.WARNING))
