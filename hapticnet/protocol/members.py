"""Faster ways to what every datagram takes: members of an enumeration, named tuples."""

import enum
from typing import Final, TypeVar

E = TypeVar("E", bound=enum.Enum)

new_tuple: Final = tuple.__new__
"""Makes a named tuple of a tuple in a third of the time."""


def plain_members(enumeration: type[E]) -> type[E]:
    """Store the members as plain attributes, for what every datagram asks for.

    Before Python 3.12 a member is found by a descriptor written in Python, which costs more than most functions here.
    """
    for member in enumeration:
        type.__setattr__(enumeration, member.name, member)
    return enumeration
