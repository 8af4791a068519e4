"""Links from a page to a source file lead to the file's page of the reference."""

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
LINK = re.compile(r"\]\(\.\./((?:dftc_rt|hil)(?:/\w+)*)(\.py)?\)")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Return a page's text with ``../dftc_rt/a.py`` turned into ``reference/dftc_rt/a.md``."""
    return LINK.sub(_page, markdown)


def _page(found: re.Match[str]) -> str:
    place, is_file = found[1], found[2]
    if not (ROOT / (place + (is_file or ""))).exists():
        raise FileNotFoundError(f"a page links to {found[0]}, which is not there")
    return f"](reference/{place}{'' if is_file else '/index'}.md)"
