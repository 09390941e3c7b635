"""Couplings: what master and slave do to the force and the position so that a hand that yields does not oscillate.

A coupling has an end at the master, the last to change a force before the limits of the device, and may have one at the
slave, between the received position and the scene: a `ports.TwoPort`. Such a coupling is asked for in the REQUEST, and
its data precedes the payloads of positions and forces. ``direct`` does nothing. Others come from packages with an entry
point in the group `ENTRY_POINT_GROUP`.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import Any, ClassVar, Final

from hapticnet.checks import check_integer, meant
from hapticnet.control.energy_bound import EnergyBound
from hapticnet.control.ports import Coupling, Port, TwoPort
from hapticnet.errors import HapticnetError, SettingsError, in_words
from hapticnet.user_code import load_user_code

ENTRY_POINT_GROUP: Final = "hapticnet.couplings"
MOST_DATA_BYTES: Final = 512  # before a payload, so that a datagram is not fragmented


@dataclass(frozen=True, slots=True)
class Direct:
    """Apply the force as it is decoded. For devices that press on the skin and do not move the hand."""

    name: ClassVar[str] = "direct"

    def master(self, port: Port) -> None:  # noqa: ARG002
        """Return that there is no end at the master."""
        return


@dataclass(frozen=True, slots=True)
class EnergyBounded:
    """Push with at most the force of a spring that holds the energy which the hand has put in.

    Attributes
    ----------
    damping
        Least damping of hand and device [N·s/m]; the hand absorbs what this makes of its motion.
    allowance_mj
        Energy [mJ] in the account when a contact begins, before the hand has done any work; at most what 2 N need.
    """

    name: ClassVar[str] = "energy-bounded"
    damping: float = 1.0
    allowance_mj: float = 1.0

    def master(self, port: Port) -> EnergyBound:
        """Return a new account of the energy at the master's port."""
        return EnergyBound(port, self.damping, 1e-3 * self.allowance_mj)


COUPLINGS: Final[Mapping[str, type[Any]]] = {made.name: made for made in (Direct, EnergyBounded)}

_installed: dict[str, type[Any]] = {}


def all_couplings() -> Mapping[str, type[Any]]:
    """Return hapticnet's couplings, and those of packages that are registered, by name."""
    return {**COUPLINGS, **_installed}


def register_installed_couplings() -> list[str]:
    """Register every coupling that an installed package offers; return the faults of the others."""
    faults = []
    for point in entry_points(group=ENTRY_POINT_GROUP):
        if point.name not in COUPLINGS and point.name not in _installed:
            try:
                made: Any = load_user_code(point.value, "coupling")
                parameters_of(made())
            except Exception as error:  # a user's code may raise anything
                faults.append(f"coupling {point.name}: {in_words(error)}")
            else:
                _installed[point.name] = made
    return faults


def make_coupling(name: str, parameters: Mapping[str, float]) -> Coupling:
    """Return a coupling; nothing is imported, because the name may come from the network.

    Raise SettingsError if no coupling has that name, or it refuses its parameters; the message lists the known ones.
    """
    made = all_couplings().get(name)
    if made is None:
        known = all_couplings()
        raise SettingsError(f"unknown coupling {name!r}{meant(name, known)}; there are: {', '.join(known)}")
    keys = [field.name for field in dataclasses.fields(made)]
    for key in parameters:
        if key not in keys:
            raise SettingsError(
                f"coupling {name!r} has no parameter {key!r}{meant(key, keys)}; it has: {', '.join(keys) or 'none'}"
            )
    try:
        coupling: Coupling = made(**parameters)
    except HapticnetError:
        raise
    except Exception as error:  # a user's coupling may raise anything
        raise SettingsError(f"coupling {name!r} refused {dict(parameters)}: {in_words(error)}") from error
    if hasattr(coupling, "slave") and not isinstance(coupling, TwoPort):
        raise SettingsError(f"coupling {name!r} has slave(), so it needs forward_bytes() and feedback_bytes()")
    return coupling


def parse_coupling(text: str) -> Coupling:
    """Return the coupling written as ``NAME[:KEY=VALUE,…]``; installed packages are imported for other names.

    Do not call it with text from the network. Raise SettingsError if there is none, or a parameter cannot be used.
    """
    name, _, rest = text.partition(":")
    name = name.strip()
    if name not in all_couplings():
        faults = register_installed_couplings()
        if faults and name not in all_couplings():
            raise SettingsError(f"unknown coupling {name!r}; could not load: {'; '.join(faults)}")
    parameters: dict[str, float] = {}
    for part in rest.split(",") if rest else ():
        key, _, value = part.partition("=")
        try:
            if key.strip() in parameters:
                raise ValueError
            parameters[key.strip()] = float(value)
        except ValueError:
            raise SettingsError(f"coupling {text!r}: {part!r} must be KEY=NUMBER, each key once") from None
    return make_coupling(name, parameters)


def parameters_of(coupling: Coupling) -> dict[str, float]:
    """Return the parameters of a coupling by name."""
    fields: Any = dataclasses.fields(coupling)  # type: ignore[arg-type]  # every coupling is a dataclass
    return {field.name: float(getattr(coupling, field.name)) for field in fields}


def data_bytes(coupling: TwoPort, axes: int) -> tuple[int, int]:
    """Return the lengths of the data before a position and before a force [B]; SettingsError if one is impossible."""
    lengths = coupling.forward_bytes(axes), coupling.feedback_bytes(axes)
    for method, length in zip(("forward_bytes", "feedback_bytes"), lengths, strict=True):
        check_integer(f"its {method}({axes})", length, 0, MOST_DATA_BYTES)
    return lengths
