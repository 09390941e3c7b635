"""What conducts a session without a device: a rig whose outcomes are given, and a front that answers at once."""

from dataclasses import replace

from hapticnet.node.procedures import Met
from hapticnet.node.settings import MasterSettings
from hapticnet_experiment import screens
from hapticnet_experiment.plan import ConditionPlan, LimitsPlan, OrderPlan, Plan
from hapticnet_experiment.rig import Meet, Pair, Presented
from hapticnet_experiment.screens import ScreenKind
from hapticnet_experiment.trial import NO_MEASURES, Played, Stimulus

DATE = "2026-11-22T10:00:00.000+00:00"

SMALL = Plan(
    name="small",
    condition=[
        ConditionPlan(name="none", codec="raw"),
        ConditionPlan(name="1 JND"),
        ConditionPlan(name="4 JND", multiplier=4.0),
    ],
    order=OrderPlan(trials=2, practice=2, practice_pairs=6, practice_rounds=2, break_s=5.0, most_attempts=3),
    limits=LimitsPlan(references_n=[1.0, 2.0], repetitions=2, step=0.05, start=0.0, largest=0.3, break_s=5.0, pairs=5),
)


def played(stimulus, *, delivered=1.0, failure=None, touched=(True, True, True)):
    """Return a trial of which the device delivered a share of each force."""
    held_n = tuple(force if here else None for force, here in zip(stimulus.breach_forces_n, touched, strict=True))
    measures = replace(
        NO_MEASURES,
        first_contact_s=1.0,
        insertions=1,
        penetrations=3,
        peaks_held_n=held_n,
        peaks_sensed_n=tuple(None if force is None else delivered * force for force in held_n),
        peak_speed_m_per_s=0.03,
        force_packets=100,
        wire_bytes=5000,
    )
    return Played(
        stimulus=stimulus,
        measures=measures,
        ticks={},
        datagrams={},
        settings=MasterSettings(),
        in_force=(),
        failure=failure,
    )


def presented(pair, error_n=0.0):
    first_n, second_n = pair.forces_n
    return Presented(held_n=pair.forces_n, sensed_n=(first_n + error_n, second_n))


def outcome_of(activity):
    """Return what a device without errors makes of an activity."""
    if isinstance(activity, Meet):
        return Met(0.5, 0.003)
    return presented(activity) if isinstance(activity, Pair) else played(activity)


class GivenRig:
    """Performs everything at once; a second passes with each activity."""

    deepest_m = None

    def __init__(self, outcome_of=outcome_of):
        self.activities = []
        self._outcome_of = outcome_of
        self._now_us = 0

    def now_us(self):
        return self._now_us

    async def run(self, activity):
        self.activities.append(activity)
        self._now_us += 1_000_000
        return self._outcome_of(activity)

    def stop(self):
        pass

    async def wait(self, duration_us):
        self._now_us += duration_us


def usual_key(flow):
    """Return the key of a participant who always goes on."""
    kind = flow.screen.kind
    if kind is ScreenKind.CONSENT:
        return screens.YES
    if kind is ScreenKind.RATING:
        return "4"
    if kind is ScreenKind.QUESTION:
        keys = dict(flow.screen.keys)
        return screens.DIFFERENT if screens.DIFFERENT in keys else "2"
    return screens.ENTER


class WillingFront:
    """Goes on at each screen, and gives the right order in each trial."""

    def __init__(self, rig):
        self._rig = rig

    async def show(self, flow):
        pass

    async def key(self, flow):
        if flow.screen.not_before_us is not None:
            await self._rig.wait(max(0, flow.screen.not_before_us - self._rig.now_us()))
        return usual_key(flow)

    async def attend(self, flow, activity, rig):
        outcome = await activity
        if flow.screen.kind is ScreenKind.TRIAL:
            answer(flow, flow.trial.order, rig.now_us())
        return outcome


def answer(flow, order, now_us):
    for key in order:
        flow.press(key, now_us)
    flow.press(screens.ENTER, now_us)


class Person:
    """Drives a flow step by step; time passes as told."""

    def __init__(self, flow, now_us=0):
        self.flow = flow
        self.now_us = now_us

    def press(self, *keys, after_s=1.0):
        for key in keys:
            self.now_us += round(1e6 * after_s)
            self.flow.press(key, self.now_us)

    def complete(self, outcome=None, after_s=1.0):
        self.now_us += round(1e6 * after_s)
        self.flow.complete(outcome or outcome_of(self.flow.activity), self.now_us)

    def walk(self):
        """Yield each screen, and answer it as usual, until the session is over."""
        while not self.flow.done:
            yield self.flow.screen
            if self.flow.activity is None:
                self.now_us = max(self.now_us, self.flow.screen.not_before_us or 0)
                self.press(usual_key(self.flow))
            else:
                if isinstance(self.flow.activity, Stimulus):
                    answer(self.flow, self.flow.trial.order, self.now_us)
                self.complete()

    def go_on_to(self, kind):
        """Go on, answering as usual, until there is a screen of a kind; return the person."""
        for screen in self.walk():
            if screen.kind is kind:
                return self
        assert self.flow.screen.kind is kind
        return self

    def go_on_and_answer(self, order=None):
        """Go on to a trial and answer it, by default right."""
        self.go_on_to(ScreenKind.TRIAL)
        answer(self.flow, order or self.flow.trial.order, self.now_us)

    def rows(self, event):
        return [row for row in self.flow.rows if row.event == event]
