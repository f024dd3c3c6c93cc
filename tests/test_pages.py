"""Pages of the documentation whose tables and figures are measured by scripts."""

import re
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGES = [path for path in sorted(DOCS.glob("*.md")) if "<!-- begin " in path.read_text()]


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_every_place_for_a_result_has_one(page):
    text = page.read_text()
    places = re.findall(r"<!-- begin (.+?) -->\n(.*?)<!-- end \1 -->", text, flags=re.DOTALL)
    assert len(places) == text.count("<!-- begin ") == text.count("<!-- end ")
    assert [name for name, content in places if not content.strip()] == []


@pytest.mark.parametrize("page", sorted(DOCS.glob("*.md")), ids=lambda path: path.stem)
def test_every_picture_is_there(page):
    named = re.findall(r"!\[[^\]]*\]\(([^)#]+)\)", page.read_text())
    assert [name for name in named if not (DOCS / name).exists()] == []
