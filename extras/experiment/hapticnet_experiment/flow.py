"""A session as a state machine without input or output: what to show, perform and store, and which keys are valid.

The state of a session follows from its rows alone, so a killed session continues where its table ends. A front
(terminal, page, simulated observer) shows `Flow.screen`, lets the rig perform `Flow.activity`, and calls `press`,
`complete` and `abort`; `session.conduct` stores the rows of each call before the next one.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, Generic

from hapticnet_experiment import screens
from hapticnet_experiment.plan import ASK, LimitsPlan, OrderPlan, Plan
from hapticnet_experiment.rig import LIFTED, Activity, Fault, Meet, Outcome
from hapticnet_experiment.rows import AnyRow, Event
from hapticnet_experiment.schedule import Schedule
from hapticnet_experiment.screens import Screen, ScreenKind, Screens

NO_CONSENT: Final = "no consent"  # reason for the end of a session whose participant did not agree
KILLED: Final = "the process ended during the trial"
CALM_US: Final = 1_000_000  # time [µs] before Escape ends the session: an earlier second press was meant for the trial


class Flow(ABC, Generic[AnyRow]):
    """The common part of both tasks of a study.

    `schedule` is a `schedule_kind`; `rows` come from earlier runs of this session, and this run begins at `now_us`
    [µs]. `constants` are values of columns that are the same in all rows: participant, session, observer, device, and
    the law.
    """

    kind: type[AnyRow]
    schedule_kind: type[Schedule]
    item: str  # the kind of item: a trial or a pair
    _part: OrderPlan | LimitsPlan

    def __init__(
        self,
        plan: Plan,
        schedule: Any,
        rows: Sequence[AnyRow],
        now_us: int,
        constants: dict[str, Any],
    ) -> None:
        self.rows = list(rows)
        self.activity: Activity | None = None  # the activity for the rig now; None while only a key is awaited
        self.answered = False  # whether the activity must be stopped, because there is an answer or an abort
        self.deepest_m: float | None = None  # deepest position [m] of the needle in this trial, noted by the front
        self.done = False  # whether the session is over, or cannot continue now: then `failure` says why
        self.failure: str | None = None
        self._plan = plan
        self._schedule = schedule
        self._constants = constants
        self._screens = Screens(plan.texts)
        self._why = plan.texts.why
        self._fresh: list[AnyRow] = []
        self._earlier = len(rows)
        self._begun_us = now_us
        # A later run continues the time of the earlier ones, regardless of the wall clock.
        self._offset_s = max((each.onset_s or 0.0) + (each.duration_s or 0.0) for each in rows) if rows else 0.0
        self._shown_us = now_us
        self._met = False
        self._failed_meetings = 0
        self._abort: str | None = None
        self._prepare()
        if any(row.event == "end" for row in rows):
            self._finish()
            return
        if rows and rows[-1].event == "started":  # part of this trial was felt, so it is repeated
            self.rows.append(replace(rows[-1], event="aborted", reason=KILLED))
            self._fresh.append(self.rows[-1])
            self._earlier += 1
        self._emit("begin", now_us, text="resumed" if rows else None)
        title = "again" if any(row.event == "consent" for row in rows) else "instructions"
        text = plan.texts.instructions[self._instructions]
        self.screen = self._screens.make(ScreenKind.INSTRUCTIONS, title, "go_on", "end", text=text)

    @property
    def declined(self) -> bool:
        """Whether the participant did not agree to take part."""
        return any(row.event == "end" and row.reason == NO_CONSENT for row in self.rows)

    def take_rows(self) -> list[AnyRow]:
        """Return the rows since the last call; store them before anything else."""
        fresh, self._fresh = self._fresh, []
        return fresh

    def press(self, key: str, now_us: int) -> None:
        """Process a key of the participant; keys without effect on this screen are ignored."""
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
        elif screen.kind is ScreenKind.BREAK:
            self._emit("break", now_us, since_us=self._shown_us)
            self._met = False  # the finger was out
            self._go_on(now_us)
        elif key == screens.ENTER and self.activity is None:
            self._go_on(now_us)
        else:
            self._take_key(key, now_us)

    def abort(self, reason: str) -> None:
        """End the present activity without an answer; it is repeated. Does nothing if there is none."""
        if self.activity is not None and not self.answered:
            self._abort = reason
            self._conclude(halted=True)

    def note_noise(self, level: float, now_us: int) -> None:
        """Note a new level of the masking noise, as a share of full scale."""
        if not self.done:
            self._emit("noise", now_us, text=f"level {level:.2f}")

    def complete(self, outcome: Outcome, now_us: int) -> None:
        """Process the outcome of the activity."""
        activity, self.activity = self.activity, None
        reason, self._abort = self._abort, None
        self.answered = False
        if reason is not None or (isinstance(outcome, Fault) and outcome.lost):
            self._met = False
        why = "stopped"
        failure = outcome.reason if isinstance(outcome, Fault) else getattr(outcome, "failure", None)
        if reason is None and failure is not None:
            reason, why = failure, "lifted" if failure == LIFTED else "fault"
        if isinstance(activity, Meet):
            self._complete_meeting(outcome, reason, "stopped" if why == "stopped" else "unmet", now_us)
        elif activity is not None:
            event: Event = "aborted"
            values = self._values(outcome)
            if reason is None:
                event, reason, why = self._judge(outcome, values)
            if reason is None:
                self._accept(values, now_us)
                return
            self._emit(event, now_us, since_us=self._shown_us, reason=reason, **values)
            self._repeat(values["this_n"], reason, why, now_us)

    def _complete_meeting(self, outcome: Outcome, reason: str | None, why: str, now_us: int) -> None:
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
            self._show(self._screens.repeat(self._why[why], now_us), now_us)

    def _go_on(self, now_us: int) -> None:
        """Show the next screen."""
        if not any(row.event == "consent" for row in self.rows):
            if self._plan.consent == ASK:
                text = self._plan.texts.agreement
                self._show(self._screens.make(ScreenKind.CONSENT, "consent", "agree", "disagree", text=text), now_us)
                return
            self._emit("consent", now_us, text=self._plan.consent)
        self._next(now_us)

    def _conclude(self, *, halted: bool) -> None:
        """Let the activity end; the participant sees at once that the key was accepted."""
        self.answered = True
        text = self._plan.texts.screens["halt_text" if halted else "moment_text"]
        self.screen = self._screens.make(ScreenKind.MOMENT, "moment", text=text)

    def _repeat(self, number: int, reason: str, why: str, now_us: int) -> None:
        """Repeat the item, or stop if it failed too often in this run.

        Earlier runs do not count: they may have had another device.
        """
        self._met = False  # the position of the finger is unknown now
        attempts = self._attempts(number, self.rows[self._earlier :])
        if attempts >= self._part.most_attempts:
            self._stop(f"{self.item} {number} failed {attempts} times; the last time: {reason}")
        else:
            self._show(self._screens.repeat(self._why[why], now_us), now_us)

    @staticmethod
    def _attempts(number: int, rows: Sequence[AnyRow]) -> int:
        return sum(row.this_n == number and row.event in ("aborted", "repeated") for row in rows)

    def _perform(self, screen: Screen, activity: Activity, now_us: int) -> None:
        self._emit("started", now_us, **self._values(None))
        self._show(screen, now_us, activity)

    def _meet(self, now_us: int) -> None:
        self._show(self._screens.make(ScreenKind.MEET, "meet", "stop"), now_us, Meet())

    def _pause(self, now_us: int) -> None:
        ends_us, progress = now_us + round(1e6 * self._part.break_s), self._progress()
        screen = self._screens.make(ScreenKind.BREAK, "pause", "go_on", "end", progress=progress, not_before_us=ends_us)
        self._show(screen, now_us)

    @property
    def _breaks(self) -> int:
        return sum(row.event == "break" for row in self.rows)

    @abstractmethod
    def _progress(self) -> str:
        """Return the progress of the session."""

    def _show(self, screen: Screen, now_us: int, activity: Activity | None = None) -> None:
        self.screen = screen
        self.activity = activity
        self._shown_us = now_us

    def _finish(self) -> None:
        self.done = True
        self.activity = None
        self.screen = self._screens.make(ScreenKind.DONE, "done")

    def _stop(self, reason: str) -> None:
        """Interrupt the session: it can continue later."""
        self.done = True
        self.activity = None
        self.failure = reason
        self.screen = self._screens.make(ScreenKind.STOPPED, "interrupted")

    def _emit(self, event: Event, now_us: int, *, since_us: int | None = None, **values: Any) -> None:
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

    @property
    @abstractmethod
    def _instructions(self) -> str:
        """Name of the text of the first screen."""

    @abstractmethod
    def _prepare(self) -> None:
        """Set up the state from plan, schedule and rows."""

    @abstractmethod
    def _next(self, now_us: int) -> None:
        """Show the next screen, once there is consent."""

    @abstractmethod
    def _take_key(self, key: str, now_us: int) -> None:
        """Process a key that only this task has."""

    @abstractmethod
    def _values(self, outcome: Outcome | None) -> dict[str, Any]:
        """Return the columns of the present item: those known beforehand, and those of its outcome."""

    @abstractmethod
    def _judge(self, outcome: Outcome, values: dict[str, Any]) -> tuple[Event, str | None, str]:
        """Return event, reason and the reason's text, if an item without a fault does not count; else None as reason.

        Adds the columns of an answer to `values`.
        """

    @abstractmethod
    def _accept(self, values: dict[str, Any], now_us: int) -> None:
        """Process an item that counts."""
