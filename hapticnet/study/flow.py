"""A session as a state machine without input or output: what to show, to perform and to store, and which keys answer.

Where a session stands follows from its rows alone, so a session that was killed goes on where its table ends. A front
(terminal, page, simulated observer) shows `Flow.screen`, lets the rig perform `Flow.activity`, and calls `press`,
`complete` and `abort`; `runner.conduct` stores the rows of each call before the next one.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, Generic

from hapticnet.study import screens
from hapticnet.study.plan import ASK, LimitsPlan, OrderPlan, Plan, QuestionPlan
from hapticnet.study.rig import Activity, Fault, Meet, Outcome
from hapticnet.study.rows import AnyRow, Event, answers_about
from hapticnet.study.screens import Screen, ScreenKind, Screens

NO_CONSENT: Final = "no consent"
"""Reason for the end of a session whose participant did not agree."""

KILLED: Final = "the process ended during the trial"

CALM_US: Final = 1_000_000
"""Time [µs] for which a screen is shown before Escape ends the session: a second press was meant for the trial."""


class Flow(ABC, Generic[AnyRow]):
    """What is common to both parts of a study.

    Parameters
    ----------
    plan
        The plan, with what the participant reads.
    part
        What it says of this part.
    rows
        Rows of earlier runs of this session.
    now_us
        Time [µs] at which this run begins.
    constants
        Values of columns that are the same in all rows: participant, session, observer and device.
    questions
        What is asked about the participant after the consent.
    instructions
        Text of the first screen.

    Attributes
    ----------
    screen
        What to show now.
    activity
        What the rig must perform now; None while only a key is awaited.
    answered
        Whether the activity must be stopped, because there is an answer or an abort.
    done
        Whether the session is over, or cannot go on now: then `failure` says why.
    deepest_m
        How deep [m] the needle was in the present trial, as the front notes it; None while that is not known.
    """

    kind: type[AnyRow]

    def __init__(
        self,
        plan: Plan,
        part: OrderPlan | LimitsPlan,
        rows: Sequence[AnyRow],
        now_us: int,
        constants: dict[str, Any],
        questions: Sequence[QuestionPlan],
        instructions: str,
    ) -> None:
        self.rows = list(rows)
        self.deepest_m: float | None = None
        self.done = False
        self.failure: str | None = None
        self.answered = False
        self.activity: Activity | None = None
        self._plan = plan
        self._part = part
        self._constants = constants
        self._questions = questions
        self._screens = Screens(plan.texts)
        self._why = plan.texts.why
        self._fresh: list[AnyRow] = []
        self._earlier = len(rows)
        self._begun_us = now_us
        # A later run continues the time of the earlier ones, whatever the clock on the wall says meanwhile.
        self._offset_s = max((each.onset_s or 0.0) + (each.duration_s or 0.0) for each in rows) if rows else 0.0
        self._shown_us = now_us
        self._met = False
        self._failed_meetings = 0
        self._abort: str | None = None
        again = any(row.event == "consent" for row in rows)
        if any(row.event == "end" for row in rows):
            self._finish()
            return
        if rows and rows[-1].event == "started":  # part of this trial was felt, and it comes again
            self.rows.append(replace(rows[-1], event="aborted", reason=KILLED))
            self._fresh.append(self.rows[-1])
            self._earlier += 1
        self._emit("begin", now_us, text="resumed" if rows else None)
        self.screen = self._screens.instructions(instructions, again=again)

    @property
    def declined(self) -> bool:
        """Whether the participant did not agree to take part."""
        return any(row.event == "end" and row.reason == NO_CONSENT for row in self.rows)

    def take_rows(self) -> list[AnyRow]:
        """Return the rows that came since the last call; store them before anything else."""
        fresh, self._fresh = self._fresh, []
        return fresh

    def press(self, key: str, now_us: int) -> None:
        """Take a key of the participant; keys that do nothing on this screen are ignored."""
        screen = self.screen
        early = screen.not_before_us is not None and now_us < screen.not_before_us
        if self.done or self.answered or (early and key == screens.ENTER):
            return
        if key not in (each for each, _ in screen.keys):
            return
        if key == screens.ESCAPE and self.activity is None:
            if now_us - self._shown_us < CALM_US:
                return
            self._emit("stopped", now_us, reason="the participant ended the session")
            self._stop("the participant ended the session")
        elif key == screens.ESCAPE:
            self.abort("the participant stopped")
        elif screen.kind is ScreenKind.CONSENT:
            if key == screens.YES:
                self._emit("consent", now_us, text=screens.hash_of(self._plan.texts.agreement))
                self._go_on(now_us)
            else:
                self._emit("end", now_us, reason=NO_CONSENT)
                self._finish()
        elif screen.kind is ScreenKind.ABOUT:
            question = self._unasked()[0]
            answer = "prefers not to say" if key == screens.PREFER_NOT else question.choices[int(key) - 1]
            self._emit("question", now_us, since_us=self._shown_us, text=f"{question.name}: {answer}", key=key)
            self._go_on(now_us)
        elif screen.kind is ScreenKind.BREAK:
            self._emit("break", now_us, since_us=self._shown_us)
            self._met = False  # the finger was out
            self._go_on(now_us)
        elif key == screens.ENTER and self.activity is None:
            self._go_on(now_us)
        else:
            self._take_key(key, now_us)

    def abort(self, reason: str) -> None:
        """End the present activity without an answer; it comes again. Does nothing where nothing is performed."""
        if self.activity is not None and not self.answered:
            self._abort = reason
            self._conclude(halted=True)

    def note_noise(self, level: float, now_us: int) -> None:
        """Note that masking noise has another level now, as a share of full scale."""
        if not self.done:
            self._emit("noise", now_us, text=f"level {level:.2f}")

    def complete(self, outcome: Outcome, now_us: int) -> None:
        """Take what came of the activity."""
        activity, self.activity = self.activity, None
        abort, self._abort = self._abort, None
        self.answered = False
        if abort is not None or (isinstance(outcome, Fault) and outcome.lost):
            self._met = False
        if isinstance(activity, Meet):
            self._complete_meeting(outcome, abort, now_us)
        elif activity is not None:
            self._complete_activity(activity, outcome, abort, now_us)

    def _complete_meeting(self, outcome: Outcome, abort: str | None, now_us: int) -> None:
        reason = abort or (outcome.reason if isinstance(outcome, Fault) else None)
        if reason is None:
            self._met = True
            self._failed_meetings = 0
            sensed_n = getattr(outcome, "sensed_n", 0.0)
            self._emit("meet", now_us, since_us=self._shown_us, text=f"sensed {sensed_n:.3f} N")
            self._go_on(now_us)
            return
        self._emit("aborted", now_us, since_us=self._shown_us, reason=reason, text="meeting")
        self._failed_meetings += 1
        if self._failed_meetings >= self._part.most_attempts:
            self._stop(reason)
        else:
            self._show(self._screens.repeat(self._why["unmet" if abort is None else "stopped"], now_us), now_us)

    def _go_on(self, now_us: int) -> None:
        """Show what comes next."""
        if not any(row.event == "consent" for row in self.rows):
            if self._plan.consent == ASK:
                self._show(self._screens.consent(), now_us)
                return
            self._emit("consent", now_us, text=self._plan.consent)
        unasked = self._unasked()
        if unasked:
            self._show(self._screens.about(unasked[0].text, unasked[0].choices), now_us)
        else:
            self._next(now_us)

    def _unasked(self) -> list[QuestionPlan]:
        """Return the questions about the participant that are still to be asked."""
        asked = answers_about(self.rows)
        return [question for question in self._questions if question.name not in asked]

    def _conclude(self, *, halted: bool) -> None:
        """Let the activity come to its end; the participant sees at once that the key was taken."""
        self.answered = True
        self.screen = self._screens.moment(halted=halted)

    def _repeat(self, number: int, begun: str, reason: str, why: str, now_us: int) -> None:
        """Let trial `number` come again, or stop if it was begun in vain too often in this run.

        Earlier runs do not count: they may have had another device.
        """
        self._met = False  # who knows where the finger is now?
        attempts = self._attempts(number, self.rows[self._earlier :])
        if attempts >= self._part.most_attempts:
            self._stop(f"{begun} {attempts} times in vain; the last time: {reason}")
        else:
            self._show(self._screens.repeat(self._why[why], now_us), now_us)

    @staticmethod
    def _attempts(number: int, rows: Sequence[AnyRow]) -> int:
        """Return how often trial `number` was begun in vain."""
        return sum(row.this_n == number and row.event in ("aborted", "repeated") for row in rows)

    def _meet(self, now_us: int) -> None:
        self._show(self._screens.meeting(), now_us, Meet())

    def _pause(self, now_us: int) -> None:
        self._show(self._screens.pause(now_us + round(1e6 * self._part.break_s), self._progress()), now_us)

    @property
    def _breaks(self) -> int:
        """Breaks so far."""
        return sum(row.event == "break" for row in self.rows)

    @abstractmethod
    def _progress(self) -> str:
        """Return how far the session is."""

    def _show(self, screen: Screen, now_us: int, activity: Activity | None = None) -> None:
        self.screen = screen
        self.activity = activity
        self._shown_us = now_us

    def _finish(self) -> None:
        self.done = True
        self.activity = None
        self.screen = self._screens.done()

    def _stop(self, reason: str) -> None:
        """Interrupt the session: it can go on later."""
        self.done = True
        self.activity = None
        self.failure = reason
        self.screen = self._screens.stopped()

    def _emit(self, event: Event, now_us: int, *, since_us: int | None = None, **values: Any) -> AnyRow:
        """Store a row; `since_us` is when its event began."""
        began_us = now_us if since_us is None else since_us
        row = self.kind(
            event=event,
            **self._constants,
            onset_s=self._offset_s + (began_us - self._begun_us) / 1e6,
            duration_s=(now_us - began_us) / 1e6,
            **values,
        )
        self.rows.append(row)
        self._fresh.append(row)
        return row

    @abstractmethod
    def _next(self, now_us: int) -> None:
        """Show what comes next, once there is consent."""

    @abstractmethod
    def _take_key(self, key: str, now_us: int) -> None:
        """Take a key that only this part of the study has."""

    @abstractmethod
    def _complete_activity(self, activity: Activity, outcome: Outcome, abort: str | None, now_us: int) -> None:
        """Take what came of an activity that only this part of the study has."""
