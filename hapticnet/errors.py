"""The one exception tree of hapticnet.

Every message is written for the person who reads it: what was wrong, the value seen, and what would be right.
"""


class HapticnetError(Exception):
    """Anything hapticnet refuses. The command line prints it as one line and exits with code 2."""


class SettingsError(HapticnetError):
    """A setting, flag or scene that cannot be used; the caller can mend it."""


class FileError(HapticnetError):
    """A file that is missing, unreadable or malformed; names the file and, where known, line and column."""


class SampleError(HapticnetError):
    """A position or force that is not finite, out of range or of the wrong number of axes."""


class PeerError(HapticnetError):
    """What came from the network breaks the protocol. It is counted and dropped; it never leaves a node."""


class RefusedError(HapticnetError):
    """The slave refused the session and said why."""


class UnavailableError(HapticnetError):
    """Something outside cannot be had now: a port in use, an address not of this host, a missing extra."""
