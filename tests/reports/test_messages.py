"""Warnings, doubts and reasons of other packages in the page's language, with English as their one source."""

import ast
import html
import re
import sys
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache, partial
from pathlib import Path

import pytest
import typer
from fake_explanation import fake_explanation
from report_batches import batch_of, graded_fruit
from rich.console import Console

from fem.estimation.modulus import warnings_of
from fem.grasp_history import GraspHistory
from fem.mismatch.catalogue import SPECS
from fem.mismatch.procedure import TWICE
from pipeline.batch.outcome import Outcome
from pipeline.batch.write_guard import require_file_apart, require_free, require_made_by_drupe
from pipeline.cli import in_language_of_locale
from pipeline.diagnosis.diagnosis import Diagnosis
from pipeline.diagnosis.explaining import explain_entry
from pipeline.diagnosis.terminal_summary import print_explanation
from pipeline.files.manifest import NotOurs, claim, enter
from pipeline.problem import BatchRefused
from recon.cameras.photos import read_photo
from recon.recon_failure import ReconFailure
from recon.surface.mesh_file import read_mesh
from reports.entries import ReferenceEntry, ScreenEntry, Suspect
from reports.explain_entries import EffectEntry, ExplainEntry
from reports.explain_page import explain_html
from reports.language import ENGLISH, LANGUAGES, spoken
from reports.messages import SENTENCES, catalogue, in_language, message
from reports.page import report_html
from reports.words import effect_name
from tactile.consistency.finding import Finding, FindingKind

ROOT = Path(__file__).parents[2]
ROOMS = ("fem", "pipeline", "recon", "tactile")
ENGLISH_ALONE = ("pipeline/history/migrations", "pipeline/start.py")
"""Statements of SQL, and the words of a computer on which drupe cannot start."""
NO_SENTENCE = (
    "#", "@alias", "text/", "drupe: internal error", "failed to map segment", "The MLE may be",
    "The random effects", "The Hessian matrix",
)  # fmt: skip
"""Comments of written files, names of units, kinds of pages, what is for developers, and texts by which
warnings of other libraries are known.
"""
HELP = frozenset({"help", "short_help", "metavar", "epilog", "show_default"})
"""Arguments with the manual of a command, which is English, as the first lines in COMMANDS are."""


def modules() -> list[Path]:
    """Those with sentences for users."""
    every = (path for room in ROOMS for path in (ROOT / room).rglob("*.py"))
    return sorted(path for path in every if not path.relative_to(ROOT).as_posix().startswith(ENGLISH_ALONE))


@cache
def templates(path: Path) -> tuple[str, ...]:
    """Texts of four words or more in a module, without docstrings, manuals and comments of written files;
    what varies is {0}, {1}, ...
    """
    return tuple(dict.fromkeys(_templates(ast.parse(path.read_text("utf-8")))))


def _templates(tree: ast.Module) -> Iterator[str]:
    inside = {id(part) for node in ast.walk(tree) for part in _no_sentences(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant | ast.JoinedStr) and id(node) not in inside:
            text = _template(node)
            words = re.findall(r"[A-Za-z]{2,}", re.sub(r"\{\d\}", " ", text))
            if " " in text and len(words) >= 4 and not text.startswith(NO_SENTENCE):
                yield text


def _no_sentences(node: ast.AST) -> Iterator[ast.AST]:
    """Parts of a node that are no sentence of their own."""
    if isinstance(node, ast.JoinedStr):
        yield from node.values
    elif isinstance(node, ast.Expr):
        yield node.value
    elif isinstance(node, ast.keyword) and node.arg in HELP:
        yield from ast.walk(node.value)
    elif (
        isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.target.id == "COMMANDS"
    ):
        yield from ast.walk(node)


def _template(node: ast.Constant | ast.JoinedStr) -> str:
    parts = node.values if isinstance(node, ast.JoinedStr) else [node]
    text = "".join(str(part.value) if _is_text(part) else "{}" for part in parts)
    pieces = re.split(r"\{\w*(?::[^{}]*)?\}", text)
    return pieces[0] + "".join(f"{{{k}}}{piece}" for k, piece in enumerate(pieces[1:]))


def _is_text(part: ast.expr) -> bool:
    return isinstance(part, ast.Constant) and isinstance(part.value, str)


OTHERS = [language for language in LANGUAGES if language != ENGLISH]


ENGLISH_WORDS = r"\b(?:the|of|and|or|with|without|from|is|recordings?|fruit|grasps?|pads?|flesh|skin|note)\b"


def words(template):
    return re.findall(r"[A-Za-z]{2,}", re.sub(r"\{\d\}", " ", template))


def first_fields(template):
    """What varies; of fields that touch, the first."""
    return sorted(re.findall(r"(?<!\})\{(\d)\}", template))


@pytest.mark.parametrize("language", OTHERS)
def test_every_sentence_is_translated(language):
    known = catalogue(language)
    missing = {path.relative_to(ROOT).as_posix(): {*templates(path)} - known.keys() for path in modules()}
    assert {name: texts for name, texts in missing.items() if texts} == {}


@pytest.mark.parametrize("language", OTHERS)
def test_no_translation_is_of_a_sentence_that_the_code_no_longer_has(language):
    said = {text for path in modules() for text in templates(path)}
    assert {text for text in catalogue(language) if len(words(text)) >= 4 and text not in said} == set()
    assert catalogue(language).keys() == catalogue(OTHERS[0]).keys()


@pytest.mark.parametrize("language", OTHERS)
def test_what_varies_is_put_into_the_translation_of_its_own_sentence(language):
    for english, translation in catalogue(language).items():
        assert first_fields(english) == sorted(re.findall(r"\{(\d)\}", translation)), english
        field = r"9\1" if takes_figures(english) else r"<\1>"
        filled = re.sub(r"(?<!\})\{(\d)\}", field, english)
        filled = re.sub(r"\{\d\}", "", filled)
        with spoken(language):
            assert message(filled) == re.sub(r"\{(\d)\}", field, translation), english


def takes_figures(english):
    """Whether a template has only conjunctions between its fields, so that any text could fit it."""
    return "{" in english and {*words(english)} <= {"and", "of", "or", "times"}


def test_no_template_is_only_fields_and_punctuation():
    assert [english for english in catalogue("de") if "{" in english and not words(english)] == []


def test_a_finding_of_a_pad_in_a_recording_is_translated_with_its_parts():
    says = (
        "force has the wrong sign: pressing must move markers to negative z and give a positive force on the "
        "fruit"
    )
    finding = Finding(FindingKind.SIGN, says, pads=("left",))
    with spoken("de"):
        assert message(f"grasp-1: {finding.sentence}.") == (
            "grasp-1: Pad links: Kraft hat das falsche Vorzeichen: Drücken muss Marker nach negativem z "
            "bewegen und eine positive Kraft auf die Frucht ergeben."
        )


def test_a_sentence_in_a_sentence_is_translated_and_figures_have_the_language_s_decimals():
    sentence = Outcome.IMPLAUSIBLE_MODULUS.sentence("14.25 MPa (expected 0.005 to 12 MPa)")
    with spoken("es"):
        assert message(sentence).startswith("E sería 14,25 MPa (se esperaba de 0,005 a 12 MPa), fuera del ")


NOT_OURS = {
    "de": "stammt nicht von drupe oder wurde seither geändert und wird daher nicht überschrieben; "
    "verschieben, oder einen anderen Ort für die Ergebnisse wählen.",
    "es": "no lo escribió drupe, o se cambió después, así que no se sobrescribe; muévalo, o elija otro lugar "
    "para los resultados.",
}


@pytest.mark.parametrize("language", OTHERS)
def test_a_file_in_the_way_is_named_in_one_language(language, tmp_path):
    (tmp_path / "mine").write_text("my notes")
    results = tmp_path / "results"
    claim(results)
    enter(results / "table.csv", b"as drupe wrote it")
    (results / "table.csv").write_text("as somebody changed it")
    with pytest.raises(NotOurs) as not_ours:
        enter(results / "table.csv", b"new")
    (tmp_path / "link").symlink_to(tmp_path / "mine")
    (tmp_path / "folder" / "inner").mkdir(parents=True)
    checks = [
        partial(require_free, [tmp_path / "mine"], "--out"),
        partial(require_free, [tmp_path / "link"], "--out"),
        partial(require_free, [results / "table.csv"], "--out"),
        partial(require_made_by_drupe, tmp_path, "--out"),
        partial(require_made_by_drupe, tmp_path / "mine", "--out"),
        partial(require_made_by_drupe, tmp_path / "new", "--out", outside=[tmp_path]),
        partial(require_file_apart, tmp_path / "new", inputs=[], folders=[tmp_path]),
    ]
    sentences = [str(not_ours.value)]
    for check in checks:
        with pytest.raises(BatchRefused) as refused:
            check()
        sentences.append(str(refused.value.problems[0]))
    assert sum("was changed since drupe wrote it" in english for english in sentences) == 1
    with spoken(language):
        assert message(sentences[0]) == f"{results / 'table.csv'}: {NOT_OURS[language]}"
        for english in sentences:
            assert re.search(r"another|choose|give", english)
            assert not re.search(r"another|choose|give", message(english)), message(english)


def test_a_warning_as_the_mechanics_gives_it_is_translated():
    history = GraspHistory.__new__(GraspHistory)
    (warning,) = warnings_of(
        history,
        (),
        least_squares_MPa=0.4,
        energy_MPa=0.5,
        residual_rms_mm=0.0,
        noise_mm=0.0,
        fruit_moves=False,
    )
    with spoken("de"):
        assert message(f"grasp-2: {warning.sentence}").startswith(
            "grasp-2: das Energieverhältnis ergibt 0,500 MPa, die kleinsten Quadrate 0,400 MPa;"
        )


@pytest.mark.parametrize("language", OTHERS)
def test_a_sentence_that_no_catalogue_has_stays_as_it_is(language):
    with spoken(language):
        assert message("A sentence of tomorrow: with 0.5 MPa.") == "A sentence of tomorrow: with 0.5 MPa."
        assert message("") == ""
    assert message("force") == "force"


OWN_SENTENCES = (
    "My own note; expected rain.", "rain in the morning; or dew", "I turned it three times",
    "[A] measured by hand", "1/quarter of the crate",
)  # fmt: skip


@pytest.mark.parametrize("language", OTHERS)
@pytest.mark.parametrize("note", OWN_SENTENCES)
def test_a_person_s_own_sentence_with_a_word_of_a_template_stays_as_it_is(note, language):
    with spoken(language):
        assert message(note) == note
        assert message(f"A: {note}") == f"A: {note}"


@pytest.mark.parametrize("language", OTHERS)
def test_notes_of_fruits_csv_stay_as_they_are(language):
    """Also where they are a sentence of drupe's."""
    note = "note: in doubt"
    fruit = replace(graded_fruit("N01", rank=1, E_MPa=0.5), facts=(("Notes", note), ("Mass", "in doubt")))
    with spoken(language):
        (batch_fruit,) = in_language(batch_of(fruit)).fruits
        assert batch_fruit.facts[0] == (message("Notes"), note)
        assert message(note) != note
        assert batch_fruit.facts[1][0] != "Mass"


@pytest.mark.parametrize(
    ("language", "photo", "mesh"), [("de", "Das Foto", "Das Netz"), ("es", "La foto", "La malla")]
)
def test_a_fault_of_a_photo_or_mesh_is_translated(language, photo, mesh, tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"")
    (tmp_path / "a.obj").write_bytes(b"")
    for read, name, words in ((read_photo, "a.jpg", photo), (read_mesh, "a.obj", mesh)):
        with pytest.raises(ReconFailure) as failure:
            read(tmp_path / name)
        with spoken(language):
            said = message(failure.value.detail)
        assert said.startswith(words), said
        assert re.findall(ENGLISH_WORDS + r"|expected", said.replace(str(tmp_path), "")) == []


@pytest.mark.parametrize("language", OTHERS)
def test_what_a_template_quotes_keeps_its_text(language):
    """Keys of settings files are words of the pages too."""
    quoted = [text for text in catalogue(language) if '"{0}"' in text or "`{0}`" in text]
    assert quoted
    for english in quoted:
        filled = re.sub(r"\{(\d)\}", lambda field: "made" if field[1] == "0" else f"<{field[1]}>", english)
        with spoken(language):
            assert re.search(r"\bmade\b", message(filled)), english


def test_each_sentence_in_the_records_of_a_page_is_translated():
    english, german = "drupe left out 3 of 24 photos.", "drupe hat 3 von 24 Fotos ausgelassen."
    suspect = Suspect(name="soft_spot", short=english, advice=english)
    screen = ScreenEntry(suspects=(suspect,), why_not=english, note=english)
    fruit = replace(
        graded_fruit("N01", rank=1, E_MPa=0.5),
        screen=screen,
        reason=english,
        smaller_error=english,
        warnings=(english,),
        doubts=(english,),
        forced=(english,),
        facts=((english, english),),
    )
    reference = ReferenceEntry(sentences=(english,), alarm=False)
    batch = replace(batch_of(fruit), faults=(english,), reference=reference)
    effect = EffectEntry(short=english, meaning=english, advice=english)
    known = {name: getattr(fake_explanation(), name) for name in ("where", "before", "after", "ranking")}
    explained = ExplainEntry(
        **{**known, "detected": True, "p_value": 0.01, "when": "load", "component": "both"},
        **{"verdict": ("skin",), "case": "N01", "category": "nectarine", "made_utc": datetime.now(UTC)},
        **dict.fromkeys(("withheld", "next_grasp", "p_nominal", "applied"), english),
        **dict.fromkeys(("doubts", "notes"), (english,)),
        effects={"skin": effect},
        parameter_words={"skin": {"Et_N_per_mm": english}},
        facts=((english, english),),
    )
    records = {
        type(record): record for record in (batch, fruit, reference, screen, suspect, effect, explained)
    }
    others = SENTENCES.keys() - records.keys()  # tests/pipeline/test_history_languages.py
    assert {kind.__module__ for kind in others} == {"reports.history_entries"}
    for kind, names in SENTENCES.items() - {(kind, SENTENCES[kind]) for kind in others}:
        assert all(english in repr(getattr(records[kind], name)) for name in names), kind
    with spoken("de"):
        for entry in (batch, explained):
            assert repr(in_language(entry)) == repr(entry).replace(english, german)


@pytest.mark.parametrize("language", OTHERS)
@pytest.mark.parametrize("spec", SPECS.values(), ids=list(SPECS))
def test_an_effect_has_a_name_and_words_in_each_language(spec, language):
    name = spec.name.replace("_", " ")
    english = [name, *vars(spec.words).values(), *(parameter.words for parameter in spec.parameters)]
    assert [text for text in english if text not in catalogue(language)] == []
    with spoken(language):
        other = effect_name(f"{spec.name}+clock_lag|none")
        assert other.startswith(message(name))
        assert not re.search(r"with|or|clock|none", other.replace(message(name), ""))


@pytest.mark.parametrize("language", OTHERS)
@pytest.mark.parametrize("verdict", [("viscoelastic",), ("skin", "unknown"), ("none",), ("unknown",)])
def test_an_answer_of_explain_is_in_one_language_on_page_and_terminal(verdict, language, capsys, monkeypatch):
    entry = explained_fruit(verdict)
    page = re.sub(r"(?s)<(style|script)\b.*?</\1>", "", explain_html(entry, language=language))
    monkeypatch.setenv("LC_ALL", f"{language}_XX.UTF-8")
    with in_language_of_locale():
        print_explanation(entry, [], console=Console(width=200))
    for said in (html.unescape(re.sub(r"<[^>]*>", " ", page)), capsys.readouterr().out):
        assert re.findall(ENGLISH_WORDS, said.replace("grasp-", "")) == []
        assert re.search(r"\d,\d", said)


def explained_fruit(verdict):
    return explain_entry(
        Diagnosis(
            explanation=fake_explanation(
                verdict=verdict if len(verdict) > 1 else verdict[0],
                next_grasp=TWICE,
                notes=("thermal_drift could not be tried: the error of the surface.",),
            ),
            grasps=("grasp-1", "grasp-2"),
            facts=(("Finite elements", "4 tetrahedra, 6 nodes"),),
        ),
        **{"case": "N-01", "category": "N", "seconds": {"in all": 3.2}, "inputs": {}, "versions": {}},
        made=datetime(2026, 11, 20, 9, tzinfo=UTC),
    )


def test_a_page_says_warnings_doubts_and_reasons_in_its_language(awkward_batch):
    sound, lost = awkward_batch.fruits[0], next(fruit for fruit in awkward_batch.fruits if not fruit.ok)
    sound = replace(
        sound,
        doubts=("doubts about the inputs",),
        warnings=("drupe left out 3 of 24 photos.",),
        smaller_error="61 % of its variance comes from: pit size; smaller with more grasps.",
    )
    lost = replace(
        lost,
        reason="Too few views: only 2 of 9 photos are usable, expected at least 6. Take 24 sharp photos from "
        "all sides, at two or three heights.",
    )
    page = report_html(replace(awkward_batch, fruits=(sound, lost)), language="de")
    for said in (
        "Zweifel an den Eingaben",
        "drupe hat 3 von 24 Fotos ausgelassen.",
        "61 % der Varianz kommen von: Größe des Steins; kleiner durch mehr Griffe.",
        "Zu wenige Ansichten: nur 2 von 9 Fotos sind brauchbar, erwartet mindestens 6.",
    ):
        assert said in page
    assert "Doubts" not in page
    assert "drupe left out" not in page


def test_the_terminal_speaks_the_language_of_the_locale(monkeypatch, capsys):
    monkeypatch.setenv("LC_ALL", "de_DE.UTF-8")
    with in_language_of_locale():
        typer.echo("  next: run `drupe check b` to find problems, then `drupe grade b`")
        sys.stderr.write("drupe: b/fruits.csv: is empty; the first line names the columns.\nplums\n")
    said = capsys.readouterr()
    assert said.out == ("  weiter: `drupe check b` ausführen, um Probleme zu finden, dann `drupe grade b`\n")
    assert said.err == "drupe: b/fruits.csv: ist leer; die erste Zeile nennt die Spalten.\nplums\n"


GERMAN_NAMES = (
    "Wärmedrift war nicht",
    "Sensordrift wurde nicht",
    "Lage des Steins mit Rutschen, Querkontraktionszahl oder keine Abweichung",
)
SPANISH_NAMES = (
    "deriva térmica no se",
    "Deriva del sensor no se",
    "posición del hueso con deslizamiento, coeficiente de Poisson o ninguna discrepancia",
)


@pytest.mark.parametrize(("language", "said"), [("de", GERMAN_NAMES), ("es", SPANISH_NAMES)])
def test_names_of_effects_in_sentences_are_translated(language, said):
    named = "pit offset with slip, poisson_ratio or no mismatch"
    apart = f"the recordings cannot distinguish {named}; record the proposed grasp, and run explain again."
    with spoken(language):
        sentences = [
            message("thermal_drift could not be tried: no frame."),
            message("Sensor drift was not looked for: no frame."),
            message(apart),
        ]
    assert all(name in sentence for name, sentence in zip(said, sentences, strict=True))
