"""Links, and what must not stand in a page."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")


def written_pages() -> list[Path]:
    """Every page of the repository."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard", "*.md"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return [ROOT / name for name in listed.stdout.splitlines() if (ROOT / name).is_file()]


PAGES = written_pages()


def anchors(page: Path) -> set[str]:
    """Those that its headings give, as code hosts make them."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    headings = re.findall(r"^#{1,6} (.+)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def links(page: Path) -> list[str]:
    """Targets of the links of a page."""
    return LINK.findall(CODE.sub("", page.read_text(encoding="utf-8")))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    for target in links(page):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, anchor = target.partition("#")
        file = page if not name else (page.parent / name).resolve()
        assert file.exists(), f"{target} in {page.relative_to(ROOT)}"
        assert file.is_relative_to(ROOT), f"{target} leads out of the repository"
        if anchor:
            assert anchor in anchors(file), f"{target} in {page.relative_to(ROOT)}"


def test_every_page_is_found_from_the_readme() -> None:
    found, waiting = set(), [ROOT / "README.md"]
    while waiting:
        page = waiting.pop()
        if page in found:
            continue
        found.add(page)
        for target in links(page):
            name = target.partition("#")[0]
            if not name or re.match(r"[a-z]+:", target):
                continue
            file = (page.parent / name).resolve()
            waiting += sorted(file.glob("*.md")) if file.is_dir() else [file] if file.suffix == ".md" else []
    assert {page for page in PAGES if page.is_relative_to(ROOT / "docs")} <= found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_pages_name_no_path_of_a_machine(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    here = re.findall(r"(?:file://|(?<![\w.`:])/(?:home|root|Users|work|tmp|opt|private)/)[\w./-]*", text)
    assert not here, here


def test_a_page_of_the_checks_own_making_is_judged(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# A head, ing: 1\n\n[a](#a-head-ing-1) `[no](link)`\n\n```\n[no](link)\n```\n[b](gone.md)\n"
    )
    assert links(page) == ["#a-head-ing-1", "gone.md"]
    assert anchors(page) == {"a-head-ing-1"}
