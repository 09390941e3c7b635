"""The plan of a study: the tasks of each participant, as a TOML file. Times are in seconds, forces in newton."""

import hashlib
import json
from pathlib import Path
from typing import Annotated, Final, Literal, TypeAlias

from pydantic import AfterValidator, BaseModel, BeforeValidator, Field, ValidationInfo, field_validator, model_validator

from hapticnet.channel.spec import parse_channel
from hapticnet.checks import meant
from hapticnet.codec.registry import make_codec, parse_codec
from hapticnet.control.force_settings import ForceControlSettings
from hapticnet.documents import STRICT, parse_document, read_document
from hapticnet.errors import HapticnetError, SettingsError
from hapticnet.files import user_path
from hapticnet.hardware import MAX_FORCE_N
from hapticnet.perception import JND_REFERENCE_FORCES_N, PAPER_FLOOR_N, PAPER_WEBER_FRACTION, WeberLaw
from hapticnet.scene.sources import PAPER_BREACH_FORCES_N, PAPER_GAP_M
from hapticnet_experiment.screens import Texts, english

# Breach forces [N] in the ratios of the paper's, all within the 4.6 N that the device reaches. The paper's largest,
# 5 N, is felt as 4.6 N: the upper gap shrinks from ln(5/3.5) = 0.357 to ln(4.54/3.33) = 0.309.
REACHABLE_BREACH_FORCES_N: Final = (1.8, 3.15, 4.5)
PLAN_FILE: Final = "plan.toml"  # name of the plan within the folder of a study
ASK: Final = "ask"  # a plan's entry for the consent: it is asked for on the screen,
NO_CONSENT: Final = "none, because "  # or it is not, with a reason
# Largest force [N] requested from the device (docs/understand/safety.md). Two forces beyond it feel the same.
REACHED_N: Final = MAX_FORCE_N - ForceControlSettings().headroom_n

Method: TypeAlias = Literal["ascending", "up-down"]
UseOfJnd: TypeAlias = Literal["preferred", "required", "ignored"]
Force: TypeAlias = Annotated[float, Field(gt=0.0, le=5.0)]
Share: TypeAlias = Annotated[float, Field(gt=0.0, le=1.0)]
Seconds: TypeAlias = Annotated[float, Field(ge=0.0, le=3600.0)]
Count: TypeAlias = Annotated[int, Field(ge=1, le=1000)]


def _channel(spec: str) -> str:
    try:
        parse_channel(spec)
    except HapticnetError as error:
        raise ValueError(str(error)) from error
    return spec


def _texts(spec: object, info: ValidationInfo) -> object:
    """Return the texts that a plan names: a file beside it, or, in a stored plan, the texts themselves."""
    if not isinstance(spec, str):
        return spec
    if not spec.endswith(".toml"):
        raise ValueError(f"texts {spec!r} is not a .toml file; write one with 'hapticnet experiment texts'")
    path = (info.context if isinstance(info.context, Path) else Path()) / user_path(spec)
    try:
        return parse_document(read_document(path), str(path), Texts)
    except HapticnetError as error:
        raise ValueError(str(error)) from error


Channel: TypeAlias = Annotated[str, AfterValidator(_channel)]


class ConditionPlan(BaseModel):
    """One way to treat the force on its way to the finger."""

    model_config = STRICT

    name: Annotated[str, Field(min_length=1, max_length=40)]  # its name in reports; the participant never sees it
    codec: str = "deadband"  # as written for ``--codec``; "raw" sends every sample
    multiplier: Annotated[float, Field(ge=0.0, le=1000.0)] = 1.0  # threshold in JNDs; not used by "raw"

    @property
    def threshold(self) -> float:
        """Threshold in JNDs; 0 without compression."""
        return 0.0 if self.codec == "raw" else self.multiplier


class OrderPlan(BaseModel):
    """The ordering task."""

    model_config = STRICT

    breach_forces_n: Annotated[list[Force], Field(min_length=3, max_length=3)] = list(PAPER_BREACH_FORCES_N)
    gap_m: Annotated[float, Field(gt=0.001, le=0.1)] = PAPER_GAP_M  # between surfaces; each is breached at half of it
    trials: Count = 10  # of each condition
    practice: Annotated[int, Field(ge=0, le=100)] = 3  # trials of a round
    practice_pairs: Annotated[int, Field(ge=0, le=300)] = 8  # pairs of tissues that must be right in a round
    practice_rounds: Count = 3  # at most
    break_s: Seconds = 60.0  # shortest break between two blocks
    time_limit_s: Annotated[float, Field(gt=0.0, le=3600.0)] = 180.0  # of a trial; the paper states none: an assumption
    rating: bool = True  # whether to ask for the quality of experience after each block
    least_delivered: Share = 0.8  # share of the held peak to be sensed in each tissue, or the trial is repeated
    most_attempts: Count = 5  # of a trial that fails, before the session stops
    equivalence_margin: Share = 0.1  # difference in the share of correct orders below which conditions count as equal

    @model_validator(mode="after")
    def _check(self) -> "OrderPlan":
        if len(set(self.breach_forces_n)) < 3:
            raise ValueError("the three breach forces must differ, or there is no right order")
        if self.practice_pairs > 3 * self.practice:
            raise ValueError(f"{self.practice} practice trials have {3 * self.practice} pairs; practice_pairs is more")
        return self


class LimitsPlan(BaseModel):
    """The measurement of the JND. Shares are of the reference force."""

    model_config = STRICT

    method: Method = "ascending"  # the paper's; the other asks for the stronger of two intervals
    references_n: Annotated[list[Force], Field(min_length=1, max_length=10)] = list(JND_REFERENCE_FORCES_N)
    repetitions: Count = 5  # series, or staircases, of each reference
    step: Share = 0.01  # of a series; it decides the result: a coarse step gives a large JND
    start: Annotated[float, Field(ge=0.0, le=1.0)] = 0.03  # largest start of a series; each is drawn from 0 to this
    largest: Share = 0.4  # difference at which a series ends without a "different"
    catch: Annotated[float, Field(ge=0.0, le=1.0)] = 0.33  # share of further series in which nothing changes
    most_false_alarms: Share = 0.25  # share of their pairs called different above which the JND is excluded
    most_censored: Annotated[int, Field(ge=0, le=1000)] = 2  # the same for series without a "different"
    pairs: Annotated[int, Field(ge=5, le=1000)] = 40  # of a staircase
    stimulus_s: Annotated[float, Field(ge=0.2, le=10.0)] = 1.0  # duration of each force
    gap_s: Annotated[float, Field(ge=0.0, le=10.0)] = 0.5  # between the two
    tolerance: Share = 0.15  # allowed deviation of the sensed force, as a share of the held one
    most_attempts: Count = 5  # of a pair that fails, before the session stops
    break_s: Seconds = 30.0  # shortest break, after each third of the series

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
            raise ValueError(f"the largest comparison is {strongest_n:g} N; the device reaches only {REACHED_N:g} N")
        return self


class JndPlan(BaseModel):
    """The law of the ordering task."""

    model_config = STRICT

    weber_fraction: Annotated[float, Field(ge=0.0, le=1.0)] = PAPER_WEBER_FRACTION  # as in ``master --weber``
    floor_n: Annotated[float, Field(ge=0.0, le=5.0)] = PAPER_FLOOR_N
    measured: UseOfJnd = "preferred"
    """Use of each participant's own JND: "preferred" uses it if it was measured with the device of the ordering task
    and no rule excludes it, otherwise the numbers above; "required" refuses a session without it; "ignored" uses the
    numbers above for all."""


class LinkPlan(BaseModel):
    """The network between master and slave."""

    model_config = STRICT

    rate_hz: Annotated[float, Field(ge=100.0, le=10_000.0)] = 1000.0  # positions a second
    forward: Channel = "perfect"  # emulated networks from master to slave and back, as for ``--channel-out``
    feedback: Channel = "perfect"


def _paper_conditions() -> list[ConditionPlan]:
    deadbands = [ConditionPlan(name=f"{times} JND", multiplier=float(times)) for times in (1, 2, 4)]
    return [ConditionPlan(name="none", codec="raw", multiplier=0.0), *deadbands]


class Plan(BaseModel):
    """A study."""

    model_config = STRICT

    name: Annotated[str, Field(min_length=1, max_length=60)] = "paper"
    masking_noise: bool = False  # whether the page plays white noise from the first press on it
    texts: Annotated[Texts, BeforeValidator(_texts)] = Field(default_factory=english)  # or the path of their file
    consent: str = ASK  # or "none, because " and the reason; the text agreed to is stored as a hash
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
        if len({each.name for each in self.condition}) < len(self.condition):
            raise ValueError("two conditions have the same name")
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


PRESETS: Final = {  # plans that need no file: the paper's, and the same with forces that the device reaches
    "paper": Plan(),
    "reachable": Plan(name="reachable", order=OrderPlan(breach_forces_n=list(REACHABLE_BREACH_FORCES_N))),
}


def find_plan(spec: str) -> Plan:
    """Return a preset, or the plan in a TOML file; raise FileError or SettingsError if it cannot be read or used."""
    if spec in PRESETS:
        return PRESETS[spec]
    path = user_path(spec)
    if path.suffix != ".toml":
        raise SettingsError(
            f"unknown plan {spec!r}{meant(spec, PRESETS)}; choose {', '.join(PRESETS)} or the path of a .toml file"
        )
    return parse_document(read_document(path), str(path), Plan, context=path.parent)
