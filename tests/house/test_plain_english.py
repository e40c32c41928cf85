"""Documents are in plain English: short sentences, and the field's terms in place of home-made ones."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = (
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    *(page.relative_to(ROOT).as_posix() for page in sorted((ROOT / "docs").rglob("*.md"))),
)

MOST_WORDS = 25
"""Of a sentence: beyond it readers lose the subject (the limit of the UK government's style guide)."""

BANNED = {
    r"alike": "similar; both",
    r"anew": "again",
    r"as graded": "name who graded, or the value",
    r"as much would be seen": "a share of normal fruit",
    r"beside everything": "together with the other effects",
    r"borders?": "interface; edge",
    r"chapters?": "subpackage",
    r"flesh graded|graded (?:flesh|mesh|meshes|modulus)": "depth-dependent modulus; locally refined mesh",
    r"foretold|foretells?": "predicted",
    r"g(?:ives?|ave|iving) way": "machine compliance",
    r"held against|held by nothing": "compared with; unsupported",
    r"holds? (?:back|away)": "hold",
    r"in spite of numbers": "accept values outside the plausible range",
    r"is of": "belongs to; was measured on",
    r"letter by letter": "exactly",
    r"looks? (?:at it|in each)|looked at|a (?:quick )?look": "inspect",
    r"mended": "fixed",
    r"nats?": "log Bayes factor",
    r"of which|of whom|whom": "two sentences",
    r"ran away": "diverged",
    r"rooms?": "package",
    r"said|unsaid": "flagged, unflagged; name who says it",
    r"(?:a|an|no|the|this|that|ball's|gel's) prints?": "contact imprint",
    r"proofs?|sealed": "blind test; cross-validation",
    r"put right": "corrected",
    r"scored once|worked on": "held-out, development",
    r"seeming(?:ly)?": "apparent",
    r"sound(?:er|est)?": "no mismatch; normal",
    r"stands? (?:in|for|here|first|beside|before|where|at the end)": "is in; means; is first",
    r"the first of these that there is": "source, by priority",
    r"traces?": "force-displacement curve",
    r"what is left|is left over|was left": "remaining; residual",
    r"what (?:the )?fruit really (?:are|is)": "true modulus",
}
"""Words that only the authors understand: what to write in their place."""


CODE = "¤"
"""Where inline code was; it counts as no word."""


def prose(text: str) -> str:
    """The text without fenced code, comments, inline code and the targets of links."""
    text = re.sub(r"^```.*?^```", "\n", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return re.sub(r"`[^`]*`", CODE, text)


def sentences(text: str) -> list[str]:
    """The sentences of running text, each on one line; a heading and a list's item end one, tables are left
    out.

    >>> sentences("# Title\\n\\nOne of\\n1.5 mm. Two: `a. b`!\\n- three\\n\\n| a. b |\\n")
    ['Title', 'One of 1.5 mm.', 'Two: ¤!', 'three']
    """
    lines = ["" if line.lstrip().startswith("|") else line for line in prose(text).splitlines()]
    items = re.sub(r"^\s*(?:[-*]|\d+\.)\s+", r"\n", "\n".join(lines), flags=re.MULTILINE)
    items = re.sub(r"^#+ (.*)$", r"\n\1\n", items, flags=re.MULTILINE)
    blocks = [" ".join(block.split()) for block in re.split(r"\n\s*\n", items)]
    return [
        sentence
        for block in blocks
        for sentence in re.split(r"(?<=[.!?])\)? (?=[^a-z]|drupe\b)", block)
        if sentence
    ]


def words(sentence: str) -> int:
    """How many words it has; signs alone are none."""
    return sum(any(c.isalnum() for c in word) for word in sentence.split())


def banned(text: str) -> list[str]:
    """The banned terms in it, with what to write in their place."""
    return [
        f"{match[0]!r}: {better}"
        for term, better in BANNED.items()
        for match in re.finditer(rf"\b(?:{term})\b", " ".join(prose(text).split()), re.IGNORECASE)
    ]


@pytest.mark.parametrize("page", PAGES)
def test_no_sentence_is_long(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    assert [(words(sentence), sentence) for sentence in sentences(text) if words(sentence) > MOST_WORDS] == []


@pytest.mark.parametrize("page", PAGES)
def test_no_term_is_banned(page):
    assert banned((ROOT / page).read_text(encoding="utf-8")) == []


def test_every_entry_of_the_glossary_is_one_short_sentence():
    text = (ROOT / "docs" / "glossary.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (?!term |---)(.+?) \| (.+?) \| .+ \|$", text, re.MULTILINE)
    assert len(rows) > 50
    assert [
        term for term, meaning in rows if len(sentences(meaning)) > 1 or words(meaning) > MOST_WORDS
    ] == []


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("Where the rig gives\nway.", ["'gives way': machine compliance"]),
        ("The command prints `a trace` of [E](#sealed-proof).", []),
    ],
)
def test_banned_terms_are_found_across_lines_and_not_in_code(text, expected):
    assert banned(text) == expected


@pytest.mark.parametrize(("count", "long"), [(MOST_WORDS, 0), (MOST_WORDS + 1, 1)])
def test_a_sentence_is_long_by_its_words_alone(count, long):
    text = "One. " + "\n".join(["Word -"] * count) + ".\n"
    assert sum(words(sentence) > MOST_WORDS for sentence in sentences(text)) == long
