"""Classes of users, named as ``FILE.py:Class`` or ``package.module:Class``: import, find and instantiate them.

Any fault in them becomes one SettingsError. Such a text runs code: never accept it from the
network.
"""

import importlib
import importlib.util
import inspect
import json
import re
import reprlib
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from itertools import islice
from numbers import Real
from operator import index
from pathlib import Path
from types import ModuleType
from typing import Any, Final, TypeAlias, cast

from hapticnet.errors import HapticnetError, SettingsError, UserCodeError, in_words, printable, shortened
from hapticnet.files import user_path
from hapticnet.interrupts import is_ctrl_c
from hapticnet.samples import LARGEST_COMPONENT, MAX_AXES, Vector

Option: TypeAlias = int | float | bool | str

_SOURCE = re.compile(r"(?P<source>(?:.+?\.py|[A-Za-z_][\w.]*):[A-Za-z_]\w*)(?::(?P<options>.*))?", re.DOTALL)

_REPR: Final = reprlib.Repr()  # shows only the beginning of long values
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = 200

_BOOLS: Final = {"true": True, "false": False}

_files: dict[Path, tuple[int, ModuleType]] = {}  # modules made from files, and when each file was last changed


@dataclass(frozen=True, slots=True)
class UserClass:
    """A class of a user, and the arguments for making its objects."""

    kind: str  # its role, such as "scene"; starts each message
    source: str  # ``FILE.py:Class`` or ``package.module:Class``, as the user wrote it
    found: Callable[..., Any]  # the class, or a function that returns an object
    options: Mapping[str, Option] = field(default_factory=dict)  # keyword arguments

    @property
    def file(self) -> Path | None:
        """The file that the user named, if it was not a module."""
        place = self.source.rpartition(":")[0]
        return user_path(place) if place.endswith(".py") else None

    @property
    def label(self) -> str:
        """Kind and source, its name in messages."""
        return f"{self.kind} {self.source}"

    def make(self) -> Any:
        """Return a new object; raise SettingsError if that fails."""
        try:
            return self.found(**self.options)
        except HapticnetError as error:  # which says itself what is wrong
            raise SettingsError(f"{self.label}: {error}") from error
        except BaseException as error:
            raise SettingsError(f"{self.label}: making it raised {raised(error)}") from error


def split_user_code(text: str) -> tuple[str, str] | None:
    """Return source and options of ``SOURCE[:KEY=VALUE,…]``; None if `text` does not have this form."""
    found = _SOURCE.fullmatch(text.strip())
    return (found["source"], found["options"] or "") if found else None


def find_user_class(text: str, kind: str, folder: Path = Path()) -> UserClass | None:
    """Import the class named by ``SOURCE[:KEY=VALUE,…]``; return None if `text` does not have this form.

    A value is a whole number, a number, true, false, or else text. The path of a file is relative to `folder`. Raises
    SettingsError if it cannot be imported or found, or an option is malformed.
    """
    parts = split_user_code(text)
    if parts is None:
        if text.strip().endswith(".py"):
            raise SettingsError(f"{kind} {text!r}: name the class in the file too, as in {text.strip()}:MyClass")
        return None
    source, rest = parts
    options = _options(rest, f"{kind} {text!r}")
    return UserClass(kind, source, load_user_code(source, kind, folder), options)


def find_installed_class(text: str, kind: str, group: str) -> UserClass | None:
    """Return the class that an installed package offers by ``NAME[:KEY=VALUE,…]``, as an entry point of a group.

    Return None if no package does; raise SettingsError if it cannot be imported, or an option is malformed.
    """
    name, _, rest = text.strip().partition(":")
    point = next(iter(entry_points(group=group, name=name)), None) if name else None
    if point is None:
        return None
    options = _options(rest, f"{kind} {text!r}")
    return UserClass(kind, name, load_user_code(point.value, kind), options)


def _options(text: str, what: str) -> dict[str, Option]:
    """Return the arguments in ``KEY=VALUE,…``; SettingsError if they are malformed."""
    options: dict[str, Option] = {}
    for part in text.split(",") if text else ():
        key, equals, value = part.partition("=")
        key = key.strip()
        if not equals or not key.isidentifier() or key in options:
            raise SettingsError(f"{what}: {part!r} must be KEY=VALUE, each key once, as in stiffness=200")
        options[key] = _option(value.strip())
    return options


def load_user_code(source: str, kind: str, folder: Path = Path()) -> Callable[..., Any]:
    """Return the class (or function) at ``FILE.py:Class`` or ``package.module:Class``; reread a file that changed."""
    place, _, name = source.rpartition(":")
    try:
        module = _run_file(folder / user_path(place)) if place.endswith(".py") else _import(place)
    except BaseException as error:
        raise SettingsError(f"{kind} {source}: importing {place} raised {raised(error)}") from error
    if module is None:
        raise SettingsError(f"{kind} {source}: cannot find {place}")
    found = getattr(module, name, None)
    if not callable(found):
        raise SettingsError(f"{kind} {source}: {place} defines no class {name!r}{_choices(module)}")
    return cast("Callable[..., Any]", found)


def method_of(made: Any, signature: str, what: str) -> Callable[..., Any]:
    """Return a method of a user's object, given as "name(argument, …)".

    Raises SettingsError if there is no such method, it is a coroutine, or it does not accept these arguments; `what`
    starts the message.
    """
    name, _, arguments = signature.rstrip(")").partition("(")
    method = attribute_of(made, name, None, what)
    if not callable(method):
        raise SettingsError(f"{what}: has no method {signature}")
    if inspect.iscoroutinefunction(method) or inspect.isgeneratorfunction(method):
        raise SettingsError(f"{what}: {name} is a coroutine or generator; it must be a plain method")
    try:
        inspect.signature(method).bind(*arguments.split(", "))
    except TypeError as error:
        raise SettingsError(f"{what}: cannot call {signature}: {error}") from error
    except ValueError:  # a method written in C, which has no signature
        pass
    return cast("Callable[..., Any]", method)


def attribute_of(made: Any, name: str, default: Any, what: str) -> Any:
    """Return an attribute of a user's object, or `default`; raise SettingsError if it is a property that raises."""
    try:
        return getattr(made, name, default)
    except BaseException as error:
        raise SettingsError(f"{what}: reading {name} raised {raised(error)}") from error


def axes_of(made: Any, what: str) -> int:
    """Return the number of axes that a user's object declares, 1 if it does not; raise SettingsError if invalid."""
    declared = attribute_of(made, "axes", 1, what)
    try:
        axes = index(declared)
    except TypeError:
        axes = 0
    if isinstance(declared, bool) or not 1 <= axes <= MAX_AXES:
        raise SettingsError(f"{what}: axes is {short(declared)}; it must be a whole number from 1 to {MAX_AXES}")
    return axes


def vector_from(result: Any, axes: int, method: str, unit: str) -> Vector:
    """Return the result of a user's method, one or more numbers, as a vector; raise UserCodeError if it is invalid."""
    # The common cases first: this is on the path of every sample.
    if type(result) is float and axes == 1 and -LARGEST_COMPONENT <= result <= LARGEST_COMPONENT:
        return (result,)
    try:
        if isinstance(result, Real):
            vector: Vector = (float(result),)
        elif isinstance(result, (str, bytes, Mapping)):
            raise TypeError
        elif getattr(result, "ndim", None) == 0:  # an array of no dimension
            vector = (float(result),)
        else:  # at most one too many, because it may be long or endless
            vector = tuple([float(each) for each in islice(result, axes + 1)])
    except (TypeError, ValueError, OverflowError):
        raise _unusable(result, axes, method, unit) from None
    if len(vector) != axes:
        raise _unusable(result, axes, method, unit)
    for component in vector:
        # Written so that NaN, which compares false with everything, is refused too.
        if not -LARGEST_COMPONENT <= component <= LARGEST_COMPONENT:
            raise _unusable(result, axes, method, unit)
    return vector


def raised(error: BaseException) -> str:
    """Return a user's exception in words; raise a KeyboardInterrupt again if Ctrl-C can cause it."""
    if is_ctrl_c(error):
        raise error
    return in_words(error)


def failure(method: str, error: BaseException) -> UserCodeError:
    """Return the error to report for an exception in a user's method; raise a KeyboardInterrupt again."""
    words = raised(error)
    return error if isinstance(error, UserCodeError) else UserCodeError(f"{method} raised {words}")


def report_of(made: Any) -> dict[str, Any]:
    """Return what a user's object reports, fit for JSON; empty if it has no ``report()``."""
    try:
        # Through JSON, so that its content cannot break the report of the run.
        reported = json.dumps(made.report(), default=str) if hasattr(made, "report") else "{}"
        return dict(json.loads(reported))
    except BaseException as error:
        return {"report": str(failure(f"{type(made).__name__}.report", error))}


def close_user_object(made: Any, what: str) -> str | None:
    """Call ``close()`` if a user's object has it; return a message if it raised, else None."""
    try:
        close = getattr(made, "close", None)
        if callable(close):
            close()
    except BaseException as error:
        return f"{what}: close raised {raised(error)}"
    return None


def short(value: object) -> str:
    """Return a value for a message: one line of at most 60 characters."""
    try:
        text = printable(_REPR.repr(value))
    except BaseException as error:
        raised(error)
        text = f"an object of type {type(value).__name__}"
    return shortened(text, 60)


def _unusable(result: Any, axes: int, method: str, unit: str) -> UserCodeError:
    right = f"a finite number [{unit}]" if axes == 1 else f"{axes} finite numbers [{unit}]"
    return UserCodeError(f"{method} returned {short(result)}; it must return {right}")


def _option(text: str) -> Option:
    if text.lower() in _BOOLS:
        return _BOOLS[text.lower()]
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return text


def _choices(module: ModuleType) -> str:
    """Return a hint that lists the classes of a module."""
    own = [name for name, each in vars(module).items() if isinstance(each, type) and each.__module__ == module.__name__]
    return f"; it defines {', '.join(own[:8])}" if own else ""


def _run_file(file: Path) -> ModuleType | None:
    if not file.is_file():
        return None
    path = file.resolve()
    changed = path.stat().st_mtime_ns
    if path in _files and _files[path][0] == changed:
        return _files[path][1]
    # The prefix keeps a user's serial.py from being mistaken for the module of that name.
    name = free = f"hapticnet_user_{file.stem}"
    number = 1
    while free in sys.modules and getattr(sys.modules[free], "__file__", None) != str(path):
        number += 1
        free = f"{name}_{number}"
    spec = importlib.util.spec_from_file_location(free, path)
    if spec is None or spec.loader is None:
        return None
    look_in(file.parent)  # as Python does for a script, so that it can import its neighbours
    module = importlib.util.module_from_spec(spec)
    before = sys.modules.get(free)
    sys.modules[free] = module  # dataclasses look up their module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        if before is None:
            del sys.modules[free]
        else:
            sys.modules[free] = before
        raise
    _files[path] = changed, module
    return module


def _import(name: str) -> ModuleType | None:
    look_in(Path.cwd())  # which a console script does not search by itself
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if error.name is not None and (name == error.name or name.startswith(f"{error.name}.")):
            return None
        raise


def look_in(folder: Path) -> None:
    """Let Python search a folder for modules, after all others."""
    path = str(folder.resolve())
    if path not in sys.path:
        sys.path.append(path)
