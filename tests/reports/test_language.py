"""Pages in German and Spanish: every sentence is in both words files, and figures are written as there."""

import ast
import re
import string
from pathlib import Path

import pytest

from recon.pit.priors import known_categories
from reports import (
    batch_overview,
    effect_words,
    explain_page,
    history_page,
    kiosk_page,
    page,
    skin_picture,
    words,
)
from reports.kiosk_page import KioskEntry, kiosk_html
from reports.language import ENGLISH, LANGUAGES, say, spoken, words_of
from reports.messages import catalogue
from reports.page import report_html

REPORTS = Path(page.__file__).parent
OTHERS = [language for language in LANGUAGES if language != ENGLISH]


def said_in_code():
    for path in REPORTS.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            said = isinstance(node, ast.Call) and getattr(node.func, "id", "") in ("say", "say_html")
            if said and isinstance(node.args[0], ast.Constant):
                yield node.args[0].value


def said_in_templates():
    for path in (REPORTS / "templates").glob("*.j2"):
        yield from re.findall(r'say(?:_html)?\(\s*"([^"]*)"', path.read_text())


def said_by_table():
    """Sentences that code looks up by a name."""
    yield from words._ADVICE.values()
    yield words._ADVICE_OTHERWISE
    yield from page._EXIT_STATUS.values()
    yield from batch_overview.REASONS
    yield from (*kiosk_page.WORDS, *kiosk_page.WORDS.values(), *kiosk_page.COUNTED.values())
    yield from kiosk_page.MISSING
    yield from (explain_page.TITLE, history_page.TITLE, *words.CATEGORIES)
    yield from (name for name, *_ in skin_picture.FROM_SIDES)
    for entry in effect_words.VERDICTS.values():
        yield from vars(entry).values()
    for table in ("LISTED", "REGIONS", "PHASES", "COMPONENTS"):
        yield from getattr(effect_words, table).values()


def fields(text):
    """What is put into a sentence, and its markup."""
    names = sorted(name for _, name, _, _ in string.Formatter().parse(text) if name)
    return names, sorted(re.findall(r"</?\w+>", text))


@pytest.mark.parametrize("language", OTHERS)
def test_every_sentence_and_no_other_is_in_the_words_file(language):
    said = {*said_in_code(), *said_in_templates(), *said_by_table()}
    known = words_of(language)
    assert said - set(known) == set()
    assert set(known) - said == set()
    for english, other in known.items():
        assert fields(english) == fields(other), english


@pytest.mark.parametrize(("language", "word"), [("de", "Rangliste"), ("es", "Clasificación")])
def test_a_page_is_in_its_language(awkward_batch, language, word):
    html = report_html(awkward_batch, language=language)
    assert f'<html lang="{language}">' in html
    assert word in html
    assert "softest first" not in html
    fruit = next(fruit for fruit in awkward_batch.fruits if fruit.E_MPa is not None)
    assert f"{fruit.E_MPa:.1f}".replace(".", ",") in html
    kiosk = kiosk_html(KioskEntry(name="m", batch=awkward_batch, recent=(fruit.fruit_id,)), language=language)
    assert f'<html lang="{language}">' in kiosk
    assert "Last fruit" not in kiosk
    assert 'lang="en"' in report_html(awkward_batch)


def test_a_language_that_nobody_knows_is_an_error():
    with pytest.raises(ValueError, match='found language "fr", expected one of en, de, es'), spoken("fr"):
        say("Ship")


def test_every_shipped_category_has_a_name_in_each_language():
    assert known_categories() == words.CATEGORIES


def test_spanish_has_a_single_word_for_a_fruit_and_for_a_recording():
    translated = {**words_of("es"), **catalogue("es")}
    for english, spanish in translated.items():
        assert not re.search(r"(?i)\bfrutas?\b", spanish)
        assert re.search(r"(?i)\blogs?\b", english) or not re.search(r"(?i)\bregistros?\b", spanish)
