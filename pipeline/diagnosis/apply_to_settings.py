"""`drupe explain --apply`: writes a confirmed effect to batch.toml, whose other text stays as it is."""

from collections.abc import Sequence
from datetime import datetime

from pydantic import ValidationError

from fem.mismatch.catalogue import SPECS
from fem.mismatch.effect_spec import Scope
from fem.mismatch.result import NONE, UNKNOWN, Candidate, Explanation, Parameter
from pipeline.batch.confirmed_effects import ConfirmedEffect, Value
from pipeline.batch.layout import write_whole
from pipeline.batch.settings import Settings
from pipeline.diagnosis.diagnosed_case import Case
from pipeline.files.plain_file import NotReadable, toml_of
from pipeline.files.toml_text import toml_value
from pipeline.problem import plain_message
from reports.effect_words import LISTED
from reports.words import effect_name


def applied(case: Case, explanation: Explanation, *, now: datetime) -> str:
    """Writes the effect found to the batch's settings if it is confirmed; returns a sentence about it.

    Confirmed: one verdict (or one pair), which improves the prediction of recordings that the fit did not
    see.
    """
    if case.batch is None:
        raise ValueError(case.name)
    path = case.batch.folder.settings
    if doubt := why_not(explanation):
        return f"Not applied: {doubt}"
    winner = next(candidate for candidate in explanation.ranking if candidate.effect == explanation.verdict)
    try:
        effects = confirmed_effects(winner, fruit_id=case.name)
    except ValidationError as error:
        return f"Not applied: {plain_message(error.errors()[0]['msg'])}."
    try:
        with path.open(encoding="utf-8", newline="") as file:
            text = file.read()
        changed = with_effects(text, effects, note=f"found by drupe explain on {now:%Y-%m-%d}")
        if changed is None:
            lines = " ".join(line for effect in effects for line in _lines(effect, note=""))
            return f"Not applied: {path} already holds [[mismatch]] of this kind; change it by hand: {lines}"
        mode = path.stat().st_mode
        write_whole(path.resolve(), changed)
        path.chmod(mode)
    except OSError as error:
        return f"Not applied: drupe cannot write {path} ({error.strerror})."
    applied_effects = " and ".join(
        f"{effect.effect} for "
        + (f"fruit {case.name} alone" if effect.fruits else "every fruit of the batch")
        for effect in effects
    )
    rest = "".join(f" {_needs_no_entry(name)}" for name in winner.effect.split("+") if _in_forces(name))
    return f"Applied: {path} now holds {applied_effects}; run `drupe grade` again to use it.{rest}"


def why_not(explanation: Explanation) -> str:
    """Why the answer is no confirmed effect; empty if it is one."""
    if not explanation.detected or explanation.verdict == NONE:
        return "nothing is missing, so there is nothing to apply."
    if explanation.verdict == UNKNOWN:
        return "the cause is unknown, so grading cannot take it into account."
    if not isinstance(explanation.verdict, str):
        names = ", ".join(LISTED.get(name, effect_name(name)) for name in explanation.verdict)
        return f"the recordings cannot distinguish {names}; record the proposed grasp, and run explain again."
    if all(map(_in_forces, explanation.verdict.split("+"))):
        return _needs_no_entry(explanation.verdict)
    if explanation.heldout is None:
        return "no second recording confirms the effect; record another grasp."
    if not explanation.heldout.rms_after < explanation.heldout.rms_before:
        return "the effect does not improve the prediction of held-out recordings."
    if explanation.heldout.rms_before <= explanation.heldout.noise_rms:
        return "the misfit of held-out recordings is within sensor noise even without the effect."
    if all(candidate.effect != explanation.verdict for candidate in explanation.ranking):
        return f"the ranking does not contain {explanation.verdict}."
    return ""


def confirmed_effects(winner: Candidate, *, fruit_id: str) -> tuple[ConfirmedEffect, ...]:
    """The winner as entries of the settings, a pair as two; raises ValidationError if a parameter is missing.

    An effect that the recorded forces include (EffectSpec.in_recorded_forces) has no entry.

    Numbers are rounded to six digits, so that the file holds what is used. In a pair a parameter may be named
    "effect.parameter".
    """
    entries = []
    for effect in winner.effect.split("+"):
        if _in_forces(effect):
            continue
        values: dict[str, Value] = {}
        spread: dict[str, float | tuple[float, ...]] = {}
        for name, parameter in _own(winner, effect).items():
            values[name] = parameter.value if isinstance(parameter.value, str) else _rounded(parameter.value)
            if parameter.sd is not None and not isinstance(parameter.value, str):
                spread[name] = _rounded(parameter.sd)
        entries.append(
            ConfirmedEffect(
                effect=effect,
                parameters=values,
                sd=spread,
                fruits=(fruit_id,) if SPECS[effect].scope is Scope.FRUIT else None,
                found_in=fruit_id,
                probability=round(winner.probability, 4),
            )
        )
    return tuple(entries)


def _own(winner: Candidate, effect: str) -> dict[str, Parameter]:
    of_effect = {}
    for name, parameter in winner.parameters.items():
        part, _, plain = name.rpartition(".")
        if part == effect or (not part and effect in SPECS and SPECS[effect].parameter(name) is not None):
            of_effect[plain] = parameter
    return of_effect


def _in_forces(effect: str) -> bool:
    return effect in SPECS and SPECS[effect].in_recorded_forces


def _needs_no_entry(effect: str) -> str:
    return f"{effect_name(effect)} needs no entry: the recorded forces include it, so E is right without one."


def _rounded(value: float | tuple[float, ...]) -> float | tuple[float, ...]:
    if isinstance(value, tuple | list):
        return tuple(float(f"{x:.6g}") for x in value)
    return float(f"{value:.6g}")


def with_effects(text: str, effects: Sequence[ConfirmedEffect], *, note: str) -> str | None:
    """`text` of a batch.toml with the effects below it; None if it does not read back as meant, or if the
    file holds an effect of the same place.
    """
    before = Settings.model_validate(toml_of(text))
    if {effect.place() for effect in effects} & {effect.place() for effect in before.mismatch}:
        return None
    end = "\r\n" if "\r\n" in text else "\n"
    added = [line for effect in effects for line in ("", *_lines(effect, note=note))]
    changed = text.rstrip() + end + end.join(added) + end
    try:
        after = Settings.model_validate(toml_of(changed))
    except (NotReadable, ValidationError):
        return None
    wanted = before.model_copy(update={"mismatch": (*before.mismatch, *effects)})
    return changed if after == wanted else None


def _lines(effect: ConfirmedEffect, *, note: str) -> list[str]:
    held = effect.model_dump(exclude_none=True)
    if not effect.sd:
        del held["sd"]
    header = f"[[mismatch]]{f'  # {note}' if note else ''}"
    return [header, *(f"{key} = {toml_value(value)}" for key, value in held.items())]
