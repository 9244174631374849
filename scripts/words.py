"""Count the words of the pages, and find sentences that are too long: `python -m scripts.words`."""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
LONGEST = 30
"""Largest number of words in a sentence of a page for users"""
MADE = "<!-- made by"
BLOCK = re.compile(r"^```.*?^```$|<!--.*?-->|!\[[^]]*\]\([^)]*\)", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\[([^]]*)\]\([^)]*\)")
CODE = re.compile(r"`[^`]*`")
WORD = re.compile(r"[^\s|]*\w[^\s|]*")
END = re.compile(r"(?<=[.!?])[*)\"]*\s+(?=[*(\"\w`])")
FOLDERS = ("tutorials", "how-to", "reference", "explanation")


def user_pages() -> list[Path]:
    """Pages for users: the README, and four kinds; those made from the code are left out."""
    pages = [ROOT / "README.md", ROOT / "docs" / "README.md"]
    pages += [page for folder in FOLDERS for page in sorted((ROOT / "docs" / folder).glob("*.md"))]
    return [page for page in pages if MADE not in page.read_text(encoding="utf-8")[:500]]


def prose(page: Path) -> str:
    """Text of a page without code blocks, comments, pictures and addresses; code in a line is a word."""
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    return CODE.sub("code", LINK.sub(r"\1", text))


def words(page: Path) -> int:
    """Number of words of a page, tables and headings included."""
    return len(WORD.findall(prose(page)))


def long_sentences(page: Path) -> list[str]:
    """Sentences with more than `LONGEST` words, tables left out."""
    paragraphs = re.split(r"\n\s*\n|\n(?=\s*(?:[-*>#|]|\d+\.) ?)", prose(page))
    sentences = [
        sentence
        for each in paragraphs
        if not each.startswith(("|", "#"))
        for sentence in END.split(each)
    ]
    return [
        " ".join(sentence.split())
        for sentence in sentences
        if len(WORD.findall(sentence)) > LONGEST
    ]


def main() -> None:
    """Print both for all pages."""
    folders = [ROOT / "docs" / name for name in ("decisions", "studies")]
    groups = {"users": user_pages()} | {
        folder.name: sorted(folder.glob("*.md")) for folder in folders
    }
    for name, pages in groups.items():
        print(f"{name}: {sum(map(words, pages))} words in {len(pages)} pages")
        if name != "users":
            continue
        for page in pages:
            print(f"  {words(page):5} {page.relative_to(ROOT)}")
            for sentence in long_sentences(page):
                print(f"        {len(WORD.findall(sentence))}: {sentence}")


if __name__ == "__main__":
    main()
