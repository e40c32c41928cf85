"""Page of an explained mismatch: one HTML file that needs no network."""

from __future__ import annotations

import base64
import math
from functools import partial

import numpy as np

from reports.effect_words import (
    LISTED,
    by_rank,
    component_in_words,
    explain_verdict,
    parts,
    when_in_words,
    where_in_words,
    words_of,
)
from reports.explain_charts import evidence_bars, force_and_residual, modulus_over_time, rms_bars
from reports.explain_entries import ExplainEntry, Record
from reports.html_templates import charted_page
from reports.language import ENGLISH, decimals, say, spoken
from reports.messages import in_language
from reports.palette import pad_marks
from reports.skin_layer import FROM_SIDES
from reports.skin_picture import BLIND_BELOW, MapStyle, coloured, map_picture
from reports.words import NOTHING, UNEXPLAINED, UNKNOWN, effect_name, number, with_sd

TITLE = "differences between simulation and recording"


def explain_html(entry: ExplainEntry, *, language: str = ENGLISH) -> str:
    """The whole page; the same record gives the same text. It escapes all text of the case.

    `language`: one of reports.language.LANGUAGES.
    """
    with spoken(language):
        return _page(in_language(entry))


def page_title(language: str) -> str:
    """The end of the page's title, by which drupe recognises a page of an earlier run."""
    with spoken(language):
        return f": {say(TITLE)}</title>"


def _page(entry: ExplainEntry) -> str:
    named = [candidate for candidate in entry.ranking if candidate.effect in entry.verdict]
    with_effect = _kind(entry) not in (NOTHING, UNEXPLAINED)
    return charted_page(
        "explain",
        title=say(TITLE),
        interval=_interval,
        heldout=_heldout,
        modulus=_modulus,
        p=_p,
        sentence=_sentence,
        capital=_capital,
        value=_value,
        titles=partial(_titles, entry),
        blind_share=_blind_share(entry),
        component=component_in_words(entry),
        entry=entry,
        named=named,
        picture=_map(entry),
        pads=pad_marks(entry.contacts_mm),
        sides=[say(name) for name, *_ in FROM_SIDES],
        meanings=_meanings(entry),
        kind=_kind(entry),
        modulus_charts=modulus_over_time(entry, with_effect=with_effect),
        evidence=evidence_bars(entry.ranking, verdict=entry.verdict),
        rms=rms_bars(entry.heldout, with_effect=with_effect) if entry.heldout else None,
        traces=[(trace.grasp, *force_and_residual(trace, with_effect=with_effect)) for trace in entry.traces],
        with_effect=with_effect,
        verdict=explain_verdict(entry),
        when=when_in_words(entry),
        where=where_in_words(entry),
        utc=entry.made_utc.strftime("%Y-%m-%d %H:%M:%S UTC"),
    )


def _kind(entry: ExplainEntry) -> str:
    if len(entry.verdict) > 1:
        return "several"
    return entry.verdict[0] if entry.verdict[0] in (NOTHING, UNEXPLAINED) else "one"


def _meanings(entry: ExplainEntry) -> list[tuple[str, str, str]]:
    """(name, meaning, advice) of every effect in the verdict, or of a verdict of only none or unknown."""
    listed = [effect for effect in by_rank(entry) if len(entry.verdict) == 1 or effect not in LISTED]
    singles = dict.fromkeys(part for effect in listed for part in parts(effect))
    known = [(name, words_of(name, entry)) for name in singles]
    return [
        (f"{_capital(effect_name(name))}: {words.short}.", words.meaning, words.advice)
        for name, words in known
        if words is not None
    ]


def _map(entry: ExplainEntry) -> str:
    """The map on the fruit from six sides, as WebP in base64; empty without a map."""
    maps = entry.maps
    style = MapStyle(signed=True)
    if maps is None or not np.isfinite(maps.modulus_score).any():
        return ""
    skin, limit = coloured(
        maps.vertices_mm,
        maps.triangles,
        np.nan_to_num(maps.modulus_score),
        style=style,
        seen=maps.visible >= BLIND_BELOW,
        contacts_mm=entry.contacts_mm,
    )
    spot = {"centre_mm": entry.where.centre_mm, "radius_mm": entry.where.radius_mm}
    return base64.b64encode(map_picture(skin, limit=limit, style=style, **spot)).decode("ascii")


def _sentence(words: str) -> str:
    """The words with a capital letter and a full stop.

    >>> _sentence("grasp across"), _sentence("Hold it.")
    ('Grasp across.', 'Hold it.')
    """
    return _capital(words) + ("" if words.endswith((".", "!", "?")) else ".")


def _capital(words: str) -> str:
    """The words with a capital letter first."""
    return words[:1].upper() + words[1:]


def _blind_share(entry: ExplainEntry) -> float | None:
    """Share of the skin's area on which the recordings could not show a change (BLIND_BELOW)."""
    if entry.maps is None:
        return None
    corners = entry.maps.vertices_mm[entry.maps.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    blind = (entry.maps.visible[entry.maps.triangles] < BLIND_BELOW).mean(axis=1)
    return float((area * blind).sum() / area.sum())


def _titles(entry: ExplainEntry, candidate: Record) -> dict[str, str]:
    """Title of each parameter with its unit; of a pair also its effect, of a further parameter its name."""
    words, titles = entry.parameter_words.get(candidate.effect, {}), dict[str, str]()
    for name, parameter in candidate.parameters.items():
        unit = "" if parameter.unit in ("", "1") else f" ({parameter.unit})"
        title, part = f"{_capital(words.get(name, name))}{unit}", name.rpartition(".")[0]
        apart = effect_name(part) if part else name
        titles[name] = f"{title}, {apart}" if part or title in titles.values() else title
    return titles


def _value(parameter: Record) -> str:
    value, sd = parameter.value, parameter.sd
    if isinstance(value, str):
        return value
    if isinstance(value, tuple):
        spread = sd if isinstance(sd, tuple) else (None,) * len(value)
        return f"({'; '.join(map(with_sd, value, spread))})"
    return with_sd(value, None if isinstance(sd, tuple) else sd)


def _heldout(gain: tuple[float, float] | None) -> str:
    """A gain in log predictive density, with its standard error."""
    return UNKNOWN if gain is None else with_sd(*gain)


def _modulus(modulus: Record | None) -> str:
    return UNKNOWN if modulus is None else with_sd(modulus.value, modulus.sd)


def _interval(parameter: Record) -> str:
    if parameter.interval is None:
        return UNKNOWN
    low, high = map(number, parameter.interval)
    return say("{low} to {high}", low=low, high=high)


def _p(p_value: float) -> str:
    if not math.isfinite(p_value):
        return UNKNOWN
    return decimals("< 0.0001" if p_value < 1e-4 else f"{p_value:.2g}")
