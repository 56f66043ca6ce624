"""The documentation builds as a site: every link leads somewhere, every page is in the menu, the API is described."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

from tests.support.environment import REPO_ROOT


def test_the_site_builds_strictly(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, cwd=REPO_ROOT, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    pages = {page.stem for page in (REPO_ROOT / "docs").glob("*.md")} - {"index"}
    assert all((tmp_path / "site" / page / "index.html").is_file() for page in pages)
    api = (tmp_path / "site/api/index.html").read_text()
    for name in ("GraspSet", "GraspPlanner", "reference_point", "fingertips", "CLOUD_STALE"):
        assert name in api, name
    assert "http" not in "".join(line for line in api.splitlines() if "<script src=" in line), (
        "from elsewhere"
    )


def test_links_to_headings_lead_there_on_github_too() -> None:
    """Its anchors keep every hyphen and blank; the site's, which the build above checks, do not."""
    for page in (REPO_ROOT / "docs").glob("*.md"):
        for file, anchor in re.findall(r"\]\(([\w.]*)#([^)]+)\)", page.read_text()):
            headings = re.findall(r"^#+ (.*)", (page.parent / (file or page.name)).read_text(), re.MULTILINE)
            anchors = [re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings]
            assert anchor in anchors, f"{page.name}: {file}#{anchor}"
