"""How a master asks for a session: HELLO, cookie, HELLO again, with back-off, until there is an answer."""

import math
from typing import Final, NamedTuple

from hapticnet.errors import PeerError
from hapticnet.protocol.events import Hinted
from hapticnet.protocol.handshake import Attempt, OpenAttempt, SealedAttempt
from hapticnet.protocol.keys import MasterKey
from hapticnet.protocol.messages import Grant, Refusal, Request, unpack_cookie, unpack_refuse, unpack_welcome
from hapticnet.protocol.seal import Seal
from hapticnet.protocol.serial_number import MODULUS
from hapticnet.protocol.settings import Entropy, SessionSettings
from hapticnet.protocol.wire import OPEN, Datagram, Kind

GROWTH: Final = 1.25
"""By how much each interval is longer than the last while HELLOs back off."""

FRESH_AFTER_US: Final = 4_000_000
"""Time [µs] after the first cookie of an attempt after which an unanswered attempt is replaced by a new one. The slave
reads each request once, so repeating one does not help if the slave has forgotten the session."""


class Granted(NamedTuple):
    """A session: the grant, the seal (None if it is open), and the sequence number that the slave counts from."""

    grant: Grant
    seal: Seal | None
    sequence: int


class Asking:
    """Ask for a session, one attempt at a time.

    Parameters
    ----------
    key
        The master's key, for sealed sessions; None for open ones.

    Attributes
    ----------
    under_way
        Whether a session is being asked for.
    """

    def __init__(self, request: Request, settings: SessionSettings, rng: Entropy, key: MasterKey | None) -> None:
        self.under_way = False
        self._request = request
        self._settings = settings
        self._rng = rng
        self._key = key
        self._attempt: Attempt | None = None
        self._cookie = b""
        self._cookie_us = 0
        self._hinted = False
        self._tries = 0
        self._tried_us: int | None = None
        self._interval_us = settings.hello_interval_us
        self._wait_us = settings.refused_retry_us

    def begin(self, ticket: bytes | None) -> None:
        """Ask for a session that goes on with the scene of `ticket`; does nothing if one is being asked for."""
        if self.under_way:
            return
        self.under_way = True
        self._request = self._request._replace(ticket=ticket)
        self._tries = 0
        self._interval_us = self._settings.hello_interval_us

    def ask_for(self, request: Request) -> Request:
        """Ask for another session from now on; return what was asked for before. Answers to earlier HELLOs are void."""
        before, self._request = self._request, request._replace(ticket=self._request.ticket)
        self._attempt = None
        self._tried_us = None
        return before

    def stop(self) -> None:
        """Stop asking."""
        self.under_way = False
        self._attempt = None

    def tick(self, now_us: int) -> bytes | None:
        """Return the HELLO to send now, if it is time for one."""
        if not self.under_way or not self._is_time(now_us):
            return None
        attempt = self._attempt
        if attempt is None or (self._cookie and now_us - self._cookie_us > FRESH_AFTER_US):
            attempt = self._attempt = self._new_attempt(now_us)
            self._cookie = b""
            self._hinted = False
            if not self._tries:
                self._interval_us = self._settings.hello_interval_us
        self._tries += 1
        if self._tries > self._settings.quick_hellos:
            self._interval_us = min(round(self._interval_us * GROWTH), self._settings.slowest_hello_us)
        self._tried_us = now_us
        return attempt.hello(self._cookie)

    def receive(self, datagram: Datagram, now_us: int) -> Granted | Refusal | Hinted | bytes | None:
        """Process a COOKIE, WELCOME or REFUSE.

        Return a session, a refusal, a hint (a refusal that should be sealed and is not), the HELLO to send now, or None
        if the answer is to another HELLO or changes nothing.

        Raises
        ------
        PeerError
            If it is malformed, or its seal is not the slave's.
        """
        if datagram.kind is Kind.COOKIE:
            cookie = unpack_cookie(datagram.body)
            attempt = self._attempt_of(cookie.nonce)
            return self._take_cookie(attempt, cookie.cookie, now_us) if attempt is not None else None
        if datagram.kind is Kind.WELCOME:
            welcome = unpack_welcome(datagram.body)
            attempt = self._attempt_of(welcome.nonce)
            if attempt is None or attempt.version != datagram.version:
                return None
            grant, seal = attempt.read(welcome.grant)
            # The seal does not cover the frame of a WELCOME: a forged sequence would make true datagrams late.
            sequence = datagram.sequence if seal is None else 0
            if isinstance(grant, Grant):
                self._check(grant)
            return Granted(grant, seal, sequence) if isinstance(grant, Grant) else grant
        refuse = unpack_refuse(datagram.body)
        attempt = self._attempt_of(refuse.nonce)
        if attempt is None:
            return None
        if attempt.version == OPEN:
            return Refusal(0, refuse.reason, refuse.code)
        if self._hinted:
            return None
        self._hinted = True  # report one per attempt: a thousand are as easy to forge
        return Hinted(refuse.reason)

    def _check(self, grant: Grant) -> None:
        """Raise PeerError if a grant holds what was not asked for: raw positions, for instance, are a choice."""
        if grant.announced and not self._request.announced:
            raise PeerError("the grant announces the contact ahead, which was not asked for")
        share, asked = grant.position_share, self._request.position_share
        if share and not math.isclose(share, asked, rel_tol=1e-6):  # a peer may compute with float32
            raise PeerError(f"the grant gives positions a share of {share:g} of the JND; {asked:g} was asked for")

    def granted(self) -> None:
        """Note that there is a session."""
        self.stop()
        self._wait_us = self._settings.refused_retry_us

    def refused(self, now_us: int) -> int:
        """Note a refusal; return how long [µs] until the next try."""
        self._attempt = None
        wait_us = self._wait_us
        self._wait_us = min(2 * wait_us, self._settings.slowest_retry_us)
        self._interval_us = wait_us
        self._tries = 0
        self._tried_us = now_us
        return wait_us

    def _is_time(self, now_us: int) -> bool:
        # A clock that went back does not tell how long it has been.
        return self._tried_us is None or not 0 <= now_us - self._tried_us < self._interval_us

    def _new_attempt(self, now_us: int) -> Attempt:
        nonce = int(self._rng.integers(0, MODULUS))
        sequence = self._settings.first_sequence
        request = self._request._replace(clock_us=now_us)
        if self._key is None:
            return OpenAttempt(request, nonce, sequence)
        return SealedAttempt(request, nonce, sequence, self._key, self._rng)

    def _attempt_of(self, nonce: int) -> Attempt | None:
        return self._attempt if self._attempt is not None and self._attempt.nonce == nonce else None

    def _take_cookie(self, attempt: Attempt, cookie: bytes, now_us: int) -> bytes | None:
        """Take a cookie; only the first one of an attempt is answered at once."""
        is_first = not self._cookie
        self._cookie = cookie
        if not is_first:
            return None
        self._cookie_us = self._tried_us = now_us
        return attempt.hello(cookie)
