"""The plan of a study: what is asked of each participant, as a TOML file. Times are in seconds, forces in newton."""

import hashlib
import json
from pathlib import Path
from typing import Annotated, Final, Literal, TypeAlias

from pydantic import BaseModel, BeforeValidator, Field, ValidationInfo, field_validator, model_validator

from hapticnet.channel.spec import parse_channel
from hapticnet.checks import meant
from hapticnet.codec.registry import make_codec, parse_codec
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.documents import NOT_BLANK, STRICT, parse_document, read_document, text_of
from hapticnet.errors import HapticnetError, SettingsError
from hapticnet.files import user_path
from hapticnet.hardware import MAX_FORCE_N
from hapticnet.perception import JND_REFERENCE_FORCES_N, PAPER_FLOOR_N, PAPER_WEBER_FRACTION, WeberLaw
from hapticnet.scene.sources import PAPER_BREACH_FORCES_N, PAPER_GAP_M
from hapticnet.study.texts import Texts, english, find_texts

REACHABLE_BREACH_FORCES_N: Final = (1.8, 3.15, 4.5)
"""Breach forces [N] in the ratios of the paper's, all within the 4.6 N that the device reaches.

The paper's largest, 5 N, is felt as 4.6 N: the upper gap shrinks from ln(5/3.5) = 0.357 to ln(4.54/3.33) = 0.309.
"""

PLAN_FILE: Final = "plan.toml"
"""Name of the plan within the folder of a study."""

ASK: Final = "ask"
NO_CONSENT: Final = "none, because "
"""What a plan says of the consent: it is asked for on the screen, or it is not, for a reason."""

REACHED_N: Final = MAX_FORCE_N - ForceControlSettings().headroom_n
"""Largest force [N] that is asked of the device (docs/understand/safety.md). Two forces beyond it feel the same."""

Arrangement: TypeAlias = Literal["blocked", "interleaved"]
Method: TypeAlias = Literal["ascending", "up-down", "bayesian"]
UseOfJnd: TypeAlias = Literal["preferred", "required", "ignored"]

Force: TypeAlias = Annotated[float, Field(gt=0.0, le=5.0)]
Share: TypeAlias = Annotated[float, Field(gt=0.0, le=1.0)]
Seconds: TypeAlias = Annotated[float, Field(ge=0.0, le=3600.0)]
Count: TypeAlias = Annotated[int, Field(ge=1, le=1000)]


class ConditionPlan(BaseModel):
    """One way to treat the force on its way to the finger.

    Attributes
    ----------
    name
        What reports call it. The participant never sees it.
    codec
        The codec as written for ``--codec``; "raw" sends every sample.
    multiplier
        Threshold in JNDs; not used by "raw".
    """

    model_config = STRICT

    name: Annotated[str, Field(min_length=1, max_length=40)]
    codec: str = "deadband"
    multiplier: Annotated[float, Field(ge=0.0, le=1000.0)] = 1.0

    @property
    def threshold(self) -> float:
        """Threshold in JNDs; 0 without compression."""
        return 0.0 if self.codec == "raw" else self.multiplier


class OrderPlan(BaseModel):
    """The ordering task.

    Attributes
    ----------
    breach_forces_n
        Breach forces of the three tissues.
    gap_m
        Distance between surfaces [m]; each is breached at half of it.
    trials
        Trials of each condition.
    arrangement
        Whether the trials of a condition come together. The paper does not say.
    practice, practice_pairs, practice_rounds
        Practice trials, the pairs of tissues that must be right among theirs, and how often they may be tried.
    break_s
        Shortest break between two blocks.
    time_limit_s
        Longest trial. The paper states none: an assumption.
    rating
        Whether the quality of experience is asked for after each block.
    least_delivered
        Share of the held peak that the sensed peak must reach in each tissue; else the trial is repeated.
    most_attempts
        Attempts of a trial that the device may fail to deliver before the session stops.
    equivalence_margin
        Difference in the share of correct orders below which 1 JND counts as equal to none, stated beforehand.
    """

    model_config = STRICT

    breach_forces_n: Annotated[list[Force], Field(min_length=3, max_length=3)] = list(PAPER_BREACH_FORCES_N)
    gap_m: Annotated[float, Field(gt=0.001, le=0.1)] = PAPER_GAP_M
    trials: Count = 10
    arrangement: Arrangement = "blocked"
    practice: Annotated[int, Field(ge=0, le=100)] = 3
    practice_pairs: Annotated[int, Field(ge=0, le=300)] = 8
    practice_rounds: Count = 3
    break_s: Seconds = 60.0
    time_limit_s: Annotated[float, Field(gt=0.0, le=3600.0)] = 180.0
    rating: bool = True
    least_delivered: Share = 0.8
    most_attempts: Count = 5
    equivalence_margin: Share = 0.1

    @model_validator(mode="after")
    def _check(self) -> "OrderPlan":
        if len(set(self.breach_forces_n)) < 3:
            raise ValueError("the three breach forces must differ, or there is no right order")
        if self.practice_pairs > 3 * self.practice:
            raise ValueError(f"{self.practice} practice trials have {3 * self.practice} pairs; practice_pairs is more")
        return self


class LimitsPlan(BaseModel):
    """The measurement of the JND.

    Attributes
    ----------
    method
        "ascending" is the paper's; the other two ask for the stronger of two intervals.
    references_n
        Reference forces.
    repetitions
        Ascending series, or staircases, of each reference.
    step
        Step of a series as a share of the reference. It decides the result: a coarse step gives a large JND.
    start
        Largest start of a series as a share of the reference; each is drawn between 0 and this.
    largest
        Difference as a share of the reference at which a series ends without a "different".
    catch
        Further series in which nothing changes, as a share of the others.
    most_false_alarms
        Share of the pairs of these series that may be called different; with more, the JND is excluded.
    most_censored
        Series of a reference that may end without a "different"; with more, the JND is excluded.
    pairs
        Pairs of a staircase.
    stimulus_s, gap_s
        Duration of each force and of the gap between the two.
    tolerance
        Share of the held force by which the sensed one may differ; else the pair is presented again.
    most_attempts
        Attempts of a pair that the device may fail to deliver before the session stops.
    break_s
        Shortest break, after each third of the series.
    """

    model_config = STRICT

    method: Method = "ascending"
    references_n: Annotated[list[Force], Field(min_length=1, max_length=10)] = list(JND_REFERENCE_FORCES_N)
    repetitions: Count = 5
    step: Share = 0.01
    start: Annotated[float, Field(ge=0.0, le=1.0)] = 0.03
    largest: Share = 0.4
    catch: Annotated[float, Field(ge=0.0, le=1.0)] = 0.33
    most_false_alarms: Share = 0.25
    most_censored: Annotated[int, Field(ge=0, le=1000)] = 2
    pairs: Annotated[int, Field(ge=5, le=1000)] = 40
    stimulus_s: Annotated[float, Field(ge=0.2, le=10.0)] = 1.0
    gap_s: Annotated[float, Field(ge=0.0, le=10.0)] = 0.5
    tolerance: Share = 0.15
    most_attempts: Count = 5
    break_s: Seconds = 30.0

    @model_validator(mode="after")
    def _check(self) -> "LimitsPlan":
        if len(set(self.references_n)) < len(self.references_n):
            raise ValueError("a reference force is given twice")
        if self.start + self.step >= self.largest:
            raise ValueError(
                f"start {self.start:g} and step {self.step:g} leave no room below largest {self.largest:g}"
            )
        strongest_n = max(self.references_n) * (1.0 + self.largest)
        if strongest_n > REACHED_N:
            raise ValueError(f"the largest comparison is {strongest_n:g} N; the device ends at {REACHED_N:g} N")
        return self


class JndPlan(BaseModel):
    """The law of the ordering task.

    Attributes
    ----------
    weber_fraction, floor_n
        As in ``master --weber`` and ``--floor``.
    measured
        Use of each participant's own JND: "preferred" uses it where it was measured with the device of the ordering
        task and no rule excludes it, and else the numbers above; "required" refuses a session without it; "ignored"
        uses the numbers above for all.
    """

    model_config = STRICT

    weber_fraction: Annotated[float, Field(ge=0.0, le=1.0)] = PAPER_WEBER_FRACTION
    floor_n: Annotated[float, Field(ge=0.0, le=5.0)] = PAPER_FLOOR_N
    measured: UseOfJnd = "preferred"


class LinkPlan(BaseModel):
    """The network between master and slave.

    Attributes
    ----------
    rate_hz
        Positions a second.
    forward, feedback
        Emulated networks from master to slave and back, as for ``--channel-out``.
    """

    model_config = STRICT

    rate_hz: Annotated[float, Field(ge=100.0, le=10_000.0)] = 1000.0
    forward: str = "perfect"
    feedback: str = "perfect"

    @field_validator("forward", "feedback")
    @classmethod
    def _check(cls, spec: str) -> str:
        try:
            parse_channel(spec)
        except HapticnetError as error:
            raise ValueError(str(error)) from error
        return spec


class QuestionPlan(BaseModel):
    """A question about the participant, such as handedness, which is asked once.

    Attributes
    ----------
    name
        Name of the answer in the data.
    text
        The question.
    choices
        Its answers; the participant may also prefer not to say.
    """

    model_config = STRICT

    name: Annotated[str, text_of("[a-z][a-z0-9_]{0,29}", "1 to 30 small letters, digits and '_', the first a letter")]
    text: Annotated[str, NOT_BLANK, Field(max_length=1000)]
    choices: Annotated[list[Annotated[str, NOT_BLANK, Field(max_length=100)]], Field(min_length=2, max_length=9)]


def _texts(spec: object, info: ValidationInfo) -> object:
    try:
        return find_texts(spec, info.context if isinstance(info.context, Path) else Path())
    except HapticnetError as error:
        raise ValueError(str(error)) from error


def _paper_conditions() -> list[ConditionPlan]:
    deadbands = [ConditionPlan(name=f"{times} JND", multiplier=float(times)) for times in (1, 2, 4)]
    return [ConditionPlan(name="none", codec="raw", multiplier=0.0), *deadbands]


class Plan(BaseModel):
    """A study.

    Attributes
    ----------
    name
        Name of the study.
    masking_noise
        Whether white noise is played: by the page from the first press on it, else only once it is switched on there;
        at a terminal by a player of the system.
    texts
        Everything that the participant reads, the consent among it: in a TOML file, a language that is shipped, or
        themselves.
    consent
        "ask": the consent is asked for on the screen, and the hash of its text is stored; or "none, because " and why.
    question
        What is asked about the participant, as ``[[question]]`` tables.
    condition
        The conditions of the ordering task, as ``[[condition]]`` tables.
    """

    model_config = STRICT

    name: Annotated[str, Field(min_length=1, max_length=60)] = "paper"
    masking_noise: bool = False
    texts: Annotated[Texts, BeforeValidator(_texts)] = Field(default_factory=english)
    consent: str = ASK
    question: Annotated[list[QuestionPlan], Field(max_length=20)] = Field(default_factory=list)
    condition: Annotated[list[ConditionPlan], Field(min_length=1, max_length=20)] = Field(
        default_factory=_paper_conditions
    )
    order: OrderPlan = Field(default_factory=OrderPlan)
    limits: LimitsPlan = Field(default_factory=LimitsPlan)
    jnd: JndPlan = Field(default_factory=JndPlan)
    link: LinkPlan = Field(default_factory=LinkPlan)

    @field_validator("consent")
    @classmethod
    def _check_consent(cls, consent: str) -> str:
        reason = consent.removeprefix(NO_CONSENT)
        if consent != ASK and (reason == consent or not reason.strip()):
            raise ValueError(
                f'it must be "{ASK}", to ask for it on the screen, or "{NO_CONSENT}…" with your reason; its text is in'
                " the file of texts"
            )
        return consent

    @model_validator(mode="after")
    def _check(self) -> "Plan":
        names = [condition.name for condition in self.condition]
        if len(set(names)) < len(names):
            raise ValueError("two conditions have the same name")
        asked = [question.name for question in self.question]
        if len(set(asked)) < len(asked):
            raise ValueError("two questions have the same name")
        law = WeberLaw()
        for condition in self.condition:
            try:
                name, parameters = parse_codec(condition.codec)
                make_codec(name, law, parameters)
            except HapticnetError as error:
                raise ValueError(f"condition {condition.name!r}: {error}") from error
        return self

    def digest(self) -> str:
        """Return a SHA-256 of everything in the plan."""
        return hashlib.sha256(json.dumps(self.model_dump(), sort_keys=True).encode()).hexdigest()


PRESETS: Final = {
    "paper": Plan(),
    "reachable": Plan(name="reachable", order=OrderPlan(breach_forces_n=list(REACHABLE_BREACH_FORCES_N))),
}
"""Plans that need no file: the paper's, and the same with forces that the device reaches."""


def find_plan(spec: str) -> Plan:
    """Return a preset, or the plan in a TOML file.

    Raises
    ------
    FileError
        If the file cannot be read.
    SettingsError
        If a key is unknown, or a value cannot be used.
    """
    if spec in PRESETS:
        return PRESETS[spec]
    path = user_path(spec)
    if path.suffix != ".toml":
        raise SettingsError(
            f"unknown plan {spec!r}{meant(spec, PRESETS)}; choose {', '.join(PRESETS)} or the path of a .toml file"
        )
    return parse_document(read_document(path), str(path), Plan, context=path.parent)
