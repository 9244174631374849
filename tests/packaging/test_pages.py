"""Pages are short, plain and up to date."""

import sys

import pytest

from scripts.make_reference import PAGES, REFERENCE
from scripts.words import long_sentences, user_pages, words
from tests import ROOT
from tests.helpers.needs import has_at_least

DECISIONS = sorted(
    path for path in (ROOT / "docs" / "decisions").glob("*.md") if path.name != "README.md"
)


@pytest.mark.skipif(
    sys.version_info[:2] != (3, 11) or not has_at_least("click", 8, 2),
    reason="other versions of Python and Click print signatures and help in another way",
)
@pytest.mark.parametrize("name", PAGES)
def test_the_reference_is_what_the_code_says(name):
    page = (REFERENCE / f"{name}.md").read_text(encoding="utf-8")
    assert page == PAGES[name](), "run python -m scripts.make_reference"


def test_pages_for_users_are_few_words():
    together = sum(map(words, user_pages()))
    assert together <= 20_000, (
        f"{together} words: shorten a page by what you add (python -m scripts.words counts them)"
    )
    assert words(ROOT / "README.md") <= 500


@pytest.mark.parametrize("page", user_pages(), ids=lambda page: str(page.relative_to(ROOT)))
def test_no_sentence_is_long(page):
    assert long_sentences(page) == []


def test_decisions_are_few_and_short():
    assert len(DECISIONS) <= 20
    assert {path.name: words(path) for path in DECISIONS if words(path) > 300} == {}
