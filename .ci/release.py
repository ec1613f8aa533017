"""Makes the files of a release: `make release VERSION=0.4.0 URL=https://github.com/OWNER/NAME`.

`pyproject.toml` has the version. VERSION is written there, into `CITATION.cff` and over the
changelog's section `Unreleased`; without VERSION these must agree already. The archives are built
from a copy of the last commit in which links have become absolute and `[project.urls]` stand, so
that the page of the package index works. They are checked with twine in an environment of its own,
the wheel is installed into an empty environment with the tested versions, and the demo runs there,
out of reach of the checkout. Only then the version is written into the checkout. Nothing is
uploaded or tagged: the last lines say what a person has to do.
"""

from __future__ import annotations

import argparse
import datetime
import os
import posixpath
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "out" / "release"
_VERSION = re.compile(r"\d+\.\d+\.\d+")
_HEADING = re.compile(r"^## (\S+)(?: \((\d{4}-\d\d-\d\d)\))?$", re.MULTILINE)
_LINK = re.compile(r"(!?\[[^\]]*\])\((?!\w+:|#)([^)\s]+)\)")


def main() -> None:
    """Carries out all steps; the first that fails ends it with one line."""
    options = _options()
    version = options.version or _project(ROOT)["version"]
    date = datetime.date.today().isoformat()
    url = options.url or _remote()
    shutil.rmtree(OUT, ignore_errors=True)
    source = OUT / "source"
    _copy_commit(source)
    if options.version:
        write_version(source, version, date)
    check_version(source, version)
    point_to(source, url, f"v{version}")
    wheel = _build(source)
    if not options.build_only:
        _try_wheel(wheel)
        if options.version:
            write_version(ROOT, version, date)
    print(_what_is_left(version, url, options.build_only))


def check_version(root: Path, version: str) -> None:
    """Ends the program if project, citation and the changelog's first section differ."""
    citation = (root / "CITATION.cff").read_text(encoding="utf-8")
    cited = {
        name: re.search(rf"^{name}: (\S+)$", citation, re.M)
        for name in ("version", "date-released")
    }
    first = _HEADING.search((root / "CHANGELOG.md").read_text(encoding="utf-8"))
    if first is None or first[1] == "Unreleased":
        sys.exit(
            "error: CHANGELOG.md begins with `Unreleased`; give a version: make release VERSION=..."
        )
    stated = {
        "pyproject.toml": (_project(root)["version"], first[2]),
        "CITATION.cff": tuple(match[1] if match else None for match in cited.values()),
        "CHANGELOG.md": (first[1], first[2]),
    }
    if first[2] is None or set(stated.values()) != {(version, first[2])}:
        sys.exit(f"error: {version} and the date of the changelog must stand everywhere: {stated}")


def point_to(source: Path, url: str, tag: str) -> None:
    """Makes the README's links absolute, and adds `[project.urls]`, in a copy of the repository."""
    readme = source / "README.md"
    readme.write_text(
        absolute_links(readme.read_text(encoding="utf-8"), url, tag), encoding="utf-8"
    )
    project = source / "pyproject.toml"
    urls = {
        "Homepage": url,
        "Documentation": f"{url}/blob/{tag}/docs/index.md",
        "Changelog": f"{url}/blob/{tag}/CHANGELOG.md",
        "Issues": f"{url}/issues",
    }
    table = "".join(f'{name} = "{address}"\n' for name, address in urls.items())
    text = project.read_text(encoding="utf-8")
    project.write_text(
        text.replace("[project.scripts]\n", f"[project.urls]\n{table}\n[project.scripts]\n", 1),
        encoding="utf-8",
    )


def absolute_links(text: str, url: str, tag: str) -> str:
    """Leads links to files of the repository to a forge: `blob` for texts, `raw` for pictures."""

    def lead(link: re.Match[str]) -> str:
        kind = "raw" if link[1].startswith("!") else "blob"
        return f"{link[1]}({url}/{kind}/{tag}/{posixpath.normpath(link[2])})"

    return _LINK.sub(lead, text)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=str(__doc__).partition("\n\n")[0])
    parser.add_argument(
        "--version", default="", help="version to release; that of pyproject.toml when left out"
    )
    parser.add_argument(
        "--url", default="", help="https address of the repository; that of `origin` when left out"
    )
    parser.add_argument(
        "--build-only", action="store_true", help="without the empty environment and the demo"
    )
    options = parser.parse_args()
    if options.version and not _VERSION.fullmatch(options.version):
        parser.error(f"VERSION {options.version!r} must be three numbers, such as 0.4.0")
    return options


def _project(root: Path) -> dict[str, str]:
    return tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def write_version(root: Path, version: str, date: str) -> None:
    """Writes version and date where they stand; a changelog without `Unreleased` stays."""
    for name, replacements in {
        "pyproject.toml": [(r'^version = ".*"$', f'version = "{version}"')],
        "CITATION.cff": [
            (r"^version: .*$", f"version: {version}"),
            (r"^date-released: .*$", f"date-released: {date}"),
        ],
        "CHANGELOG.md": [(r"^## Unreleased$", f"## {version} ({date})")],
    }.items():
        path = root / name
        text = path.read_text(encoding="utf-8")
        for pattern, replacement in replacements:
            text = re.sub(pattern, replacement, text, count=1, flags=re.MULTILINE)
        path.write_text(text, encoding="utf-8")


def _remote() -> str:
    """Reads the address of `origin`, as a browser opens it."""
    done = subprocess.run(
        ["git", "remote", "get-url", "origin"], cwd=ROOT, capture_output=True, text=True
    )
    address = re.sub(r"^git@([^:]+):", r"https://\1/", done.stdout.strip()).removesuffix(".git")
    if not address.startswith("https://"):
        sys.exit("error: links need the address of the repository: make release URL=https://...")
    return address


def _copy_commit(folder: Path) -> None:
    """Copies the last commit; refuses changes that are not in it."""
    changed = _output("git", "status", "--porcelain", "--untracked-files=all")
    if changed:
        sys.exit(f"error: commit or remove these first:\n{changed}")
    folder.mkdir(parents=True)
    archive = OUT / "source.tar"
    _run("git", "archive", "--output", str(archive), "HEAD")
    with tarfile.open(archive) as files:
        files.extractall(folder, filter="data")
    archive.unlink()


def _build(source: Path) -> Path:
    """Builds both archives and checks them, with tools in an environment of their own."""
    tools = _environment("tools")
    _run(str(tools / "pip"), "install", "--quiet", "build", "twine")
    _run(str(tools / "python"), "-m", "build", "--outdir", str(OUT / "dist"), str(source))
    files = sorted(map(str, (OUT / "dist").iterdir()))
    _run(str(tools / "twine"), "check", "--strict", *files)
    (wheel,) = (OUT / "dist").glob("*.whl")
    return wheel


def _try_wheel(wheel: Path) -> None:
    """Installs the wheel into an empty environment and runs the demo there."""
    binaries = _environment("empty")
    _run(
        str(binaries / "pip"), "install", "--quiet", str(wheel), "-c", str(ROOT / "constraints.txt")
    )
    away = OUT / "away"
    away.mkdir()
    for words in (["--version"], ["models", "check"], ["demo", "--out", "demo"]):
        _run(str(binaries / "aerodima"), *words, cwd=away)


def _environment(name: str) -> Path:
    """Makes an environment; returns the folder of its programs."""
    venv.create(OUT / name, with_pip=True, clear=True)
    return OUT / name / "bin"


def _run(*words: str, cwd: Path = ROOT) -> None:
    print("$", *words, flush=True)
    environment = {
        key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "VIRTUAL_ENV")
    }
    status = subprocess.run(words, cwd=cwd, env=environment).returncode
    if status:
        sys.exit(f"error: {words[0]} ended with status {status}")


def _output(*words: str) -> str:
    return subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True).stdout


def _what_is_left(version: str, url: str, build_only: bool) -> str:
    """Lists what a person has to do, in its order."""
    tested = (
        "was left out: run `make release` without --build-only"
        if build_only
        else f"is in {OUT}/away/demo: look at it"
    )
    return f"""
{OUT}/dist has the archives of {version}. To be done by a person:
1. The demo of the wheel {tested}.
2. Read `git diff`, which has version and date; commit it.
3. git tag -a v{version} -m {version} && git push origin HEAD v{version}
   The links of the archives lead to {url}/blob/v{version}.
4. Before the first upload register the name aerodima-workbench at the index, as its owner.
5. {OUT}/tools/bin/twine upload {OUT}/dist/*
6. Make a release of the tag on the forge, with its section of CHANGELOG.md and these files."""


if __name__ == "__main__":
    main()
