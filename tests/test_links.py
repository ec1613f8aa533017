"""Links of all texts lead to files, for a reader of a clone or on a forge."""

import re

from tests.code_measure import PACKAGES, ROOT

TEXTS = [
    *ROOT.glob("*.md"),
    *(
        path
        for name in (*PACKAGES, "docs", "models", "tests")
        for path in (ROOT / name).rglob("*.md")
    ),
]
CODE = re.compile(r"^(```|~~~).*?^\1", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"(?:\]\(|^\[[^\]]+\]: *)(?!\w+:|#)([^)\s#]+)", re.MULTILINE)


def test_relative_links_lead_to_files():
    links = {
        (path, link)
        for path in TEXTS
        for link in LINK.findall(CODE.sub("", path.read_text(encoding="utf-8")))
    }
    assert len(links) >= 80
    assert {(path, link) for path, link in links if not (path.parent / link).exists()} == set()
