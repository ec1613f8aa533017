"""Changes of `make release` to a copy of the repository."""

import importlib.util
import re
import shutil
import tomllib

import pytest

from tests.code_measure import ROOT

SPEC = importlib.util.spec_from_file_location("release", ROOT / ".ci" / "release.py")
release = importlib.util.module_from_spec(SPEC)
SPEC.loader.exec_module(release)
URL = "https://example.org/owner/name"


@pytest.fixture
def copy(tmp_path):
    for name in ("pyproject.toml", "CITATION.cff", "CHANGELOG.md", "README.md"):
        shutil.copy(ROOT / name, tmp_path)
    changelog = tmp_path / "CHANGELOG.md"
    text = changelog.read_text(encoding="utf-8")
    changelog.write_text(re.sub("^## .*$", "## Unreleased", text, count=1, flags=re.MULTILINE))
    return tmp_path


def test_version_and_date_are_the_same_everywhere_once_they_are_written(copy):
    with pytest.raises(SystemExit, match="Unreleased"):
        release.check_version(copy, "9.0.0")
    release.write_version(copy, "9.0.0", "2030-01-02")
    release.check_version(copy, "9.0.0")


def test_links_of_the_archives_lead_to_the_tag_on_the_forge(copy):
    release.point_to(copy, URL, "v9.0.0")
    project = tomllib.loads((copy / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    targets = re.findall(r"\]\(([^)]+)\)", (copy / "README.md").read_text(encoding="utf-8"))
    assert f"{URL}/blob/v9.0.0/docs/index.md" in {*targets} & {*project["urls"].values()}
    assert all(target.startswith("https://") for target in targets)
    picture = release.absolute_links("![a](docs/a.png)", URL, "v9.0.0")
    assert picture == f"![a]({URL}/raw/v9.0.0/docs/a.png)"
